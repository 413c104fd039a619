"""Read recordings from files and tables in memory, and write them without loss of precision."""

import gzip
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from pendulum_env._typing import JSON, Array
from pendulum_env.errors import RecordingError
from pendulum_env.files import replace_file
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.recording.actuator import Actuator, parse_actuator
from pendulum_env.recording.building import build_recordings
from pendulum_env.recording.columns import NONE, check_columns_option, find_columns
from pendulum_env.recording.formats import Readable, find_format, find_stem, get_label, read_table
from pendulum_env.recording.joint_names import name_errors
from pendulum_env.recording.notes import warn_of_notes
from pendulum_env.recording.record import Recording
from pendulum_env.recording.table import RawTable


@refuse_unknown_arguments
def read_recording(
    source: Readable,
    *,
    unwrap: bool = False,
    columns: Mapping[str, str | None] | None = None,
    drive: Actuator | Mapping[str, Any] | None = None,
    name: str | None = None,
    has_gravity: bool = True,
) -> Recording:
    """Read a file or table with the columns time, position and torque, and optional further quantities.

    Without a column that may be torque, the recording is a free swing with zero torque.

    Formats are CSV (also .csv.gz, .tsv, .txt), Parquet, NPZ and MATLAB, and with the extra `formats` HDF5, MATLAB 7.3,
    Excel, MCAP and ROS bags, and an episode of a LeRobot dataset, `FOLDER#12`. `STATES.csv+GOALS.csv` are two files in
    one folder, with the same times; names of columns of the second one then begin with `goal_`.

    Columns are found by common names, units are converted to s, rad, N m and rad/s, and slightly uneven time is made
    uniform. All changes are listed in the recording's `notes`. Rows and columns that are left out, and units that are
    uncertain, are also a `RecordingWarning`.

    Args:
        source: path of a file, or a table in memory: a data frame of pandas or Polars, a table of pyarrow, or a mapping
            of arrays, which may be nested.
        unwrap: undo jumps of a turn in position, which are refused otherwise.
        columns: columns by quantity (time, position, torque, velocity, reference, segment), each in the form
            `NAME:UNIT*GAIN/RATIO+OFFSET`: `{"position": "-Winkel:deg/6", "torque": "current:A*0.091"}`. `none` or None
            omits a quantity; torque is then zero. Units are s, ms, us, ns; rad, mrad, deg, rev, counts; rad/s, deg/s,
            rpm, rev/s, counts/s; Nm, mNm, Ncm, kgfcm, ozfin, lbfft, A, mA, V, duty. Counts need the counts per turn
            (`enc:counts/4096`), and currents a torque constant (`*?` if it is unknown).
        drive: controller that follows the reference, or its settings as in a study. Torque is then read from a column
            that the user names or from the controller's output (duty, current), or computed from the controller.
        name: name of the recording; by default that of the file, or `recording`.
        has_gravity: whether gravity may act on the joint, and so show the unit of its angle.

    Raises:
        TypeError: if the source has another type, or `columns` is not a mapping of quantities to texts.
        RecordingError: if the file cannot be read or its content is implausible; the message is one sentence with the
            file, the data row (from 1, without header and blank lines), the reason and the remedy.
    """
    recording = read_rows(source, unwrap=unwrap, columns=columns, drive=drive, name=name, has_gravity=has_gravity)
    warn_of_notes(get_label(source, name), recording.notes)
    return recording


def read_rows(
    source: Readable,
    *,
    unwrap: bool,
    columns: Mapping[str, str | None] | None,
    drive: Actuator | Mapping[str, Any] | None = None,
    name: str | None = None,
    has_gravity: bool = True,
) -> Recording:
    """Read a recording as `read_recording`, without warnings."""
    check_columns_option(columns)
    drive = parse_actuator(drive) if isinstance(drive, Mapping) else drive
    named_columns = {quantity: NONE if text is None else text for quantity, text in (columns or {}).items()}
    log_format = describe_reading(named_columns, unwrap, drive)
    options: dict[str, Any] = {"unwrap": unwrap, "controller": drive, "name": name, "has_gravity": has_gravity}
    return read_joint_rows(source, {"": named_columns}, log_format, **options)[""]


def read_joint_rows(
    source: Readable,
    columns: Mapping[str, Mapping[str, str]],
    log_format: JSON,
    *,
    unwrap: bool,
    controller: Actuator | None = None,
    name: str | None = None,
    has_gravity: bool = True,
) -> dict[str, Recording]:
    """Read a recording of each joint of a file, with the same instants; `columns` are by joint and quantity.

    Errors name the joint, unless its name is empty.
    """
    label, is_file = get_label(source, name), isinstance(source, str | os.PathLike)
    tables = dict[str, RawTable]()
    try:
        for joint, named_columns in columns.items():
            output = None if controller is None else controller.select_joint(joint).output_name
            find = partial(find_columns, named_columns=named_columns, output=output)
            with name_errors(joint):
                tables[joint] = read_table(source, find)
        stem = name or (find_stem(Path(label)) if is_file else label)
        return build_recordings(stem, tables, unwrap, controller, columns, log_format, has_gravity)
    except RecordingError as error:
        raise type(error)(f"{label}: {error}") from error.__cause__


def describe_reading(columns: Mapping[str, str], unwrap: bool = False, drive: Actuator | None = None) -> JSON:
    """Return the given arguments of `read_recording` as keys of a study."""
    options = {"columns": dict(columns), "unwrap": unwrap, "drive": drive and drive.get_settings()}
    return {key: value for key, value in options.items() if value}


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write the columns time, position, torque and optional ones in the format of the suffix.

    A column `segment` numbers the segments, if there are several. A known load is part of a study, not of the file.

    Floats are written exactly. The file is written completely or not at all.

    Raises:
        RecordingError: if the suffix is unknown or the file cannot be written.
    """
    columns = recording.columns
    if len(recording.starts) > 1:  # segment of each sample, from 0
        numbers = np.searchsorted(recording.starts, np.arange(len(recording)), side="right")
        columns["segment"] = np.asarray(numbers - 1.0)
    path = Path(path)
    try:
        write = WRITERS[find_format(path, WRITERS)]
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    try:
        with replace_file(path) as file:
            write(file, columns)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror}): choose another place") from error


def _write_csv(file: BinaryIO | gzip.GzipFile, columns: dict[str, Array]) -> None:
    file.write((",".join(columns) + "\n").encode())
    pacsv.write_csv(pa.table(columns), file, pacsv.WriteOptions(include_header=False))  # shortest exact decimals


def _write_gzip(file: BinaryIO, columns: dict[str, Array]) -> None:
    # without name and time, equal data give equal bytes
    with gzip.GzipFile(filename="", mode="wb", fileobj=file, compresslevel=5, mtime=0) as compressed:
        _write_csv(compressed, columns)


def _write_parquet(file: BinaryIO, columns: dict[str, Array]) -> None:
    import pyarrow.parquet as pq  # slow import

    pq.write_table(pa.table(columns), file)


WRITERS: dict[str, Callable[[BinaryIO, dict[str, Array]], None]] = {
    ".csv": _write_csv,
    ".csv.gz": _write_gzip,
    ".parquet": _write_parquet,
    ".npz": lambda file, columns: np.savez_compressed(file, allow_pickle=False, **columns),
}
