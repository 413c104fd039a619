"""Read recordings from files and tables in memory."""

import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from pendulum_env._typing import JSON
from pendulum_env.errors import RecordingError
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.recording.building import build_recording
from pendulum_env.recording.columns import NONE, check_named, find_columns
from pendulum_env.recording.formats import Readable, find_stem, get_label, read_table
from pendulum_env.recording.record import Recording
from pendulum_env.servo import ServoDrive


@refuse_unknown_arguments
def read_recording(
    source: Readable,
    *,
    unwrap: bool = False,
    columns: Mapping[str, str | None] | None = None,
    drive: ServoDrive | None = None,
    name: str | None = None,
) -> Recording:
    """Read a file or table with columns time, position, torque and perhaps velocity, reference, segment and others.

    Without a torque column, and if no column of an unknown name could be one, it is a free swing: torque is zero.

    CSV (also .csv.gz, .tsv, .txt), Parquet, NPZ and MATLAB are read as they are; HDF5, MATLAB 7.3, Excel, MCAP and bags
    of ROS need the extra `formats`.

    Columns are found by common names, their units converted to s, rad, N m, rad/s; slightly uneven time is made
    uniform. Whatever was changed is said in the recording's `notes`.

    Args:
        source: path of a file; or a table in memory: a data frame of pandas or Polars, a table of pyarrow, or a mapping
            of arrays, which may be nested.
        unwrap: undo jumps of 2 pi in position, which are refused otherwise.
        columns: which column is which quantity, where the file's own names do not tell, by quantity (time, position,
            torque, velocity, reference, segment), each `NAME:UNIT*GAIN/RATIO+OFFSET`: `{"position": "-Winkel:deg/6",
            "torque": "current:A*0.091"}`; `none` or None leaves one out: torque is then zero. Units are s, ms, us, ns;
            rad, mrad, deg, rev, counts; rad/s, deg/s, rpm, rev/s, counts/s; Nm, mNm, Ncm, A, mA, V, duty. Counts need
            the counts of a turn (`enc:counts/4096`), and currents a torque constant (`*?` if it is to be found).
        drive: the controller that followed the reference. Then torque is what a column of its output (duty, current)
            or of the user's naming holds, or else what the controller asked for.
        name: of the recording; by default that of the file, or `recording`.

    Raises:
        TypeError: if the source is neither, or `columns` are no mapping of quantities to texts.
        RecordingError: if the file cannot be read or its content cannot be trusted: one sentence with the file, the
            data row (from 1, header and blank lines not counted) where there is one, the reason and the remedy.
    """
    check_named(columns)
    label, is_file = get_label(source, name), isinstance(source, str | os.PathLike)
    try:
        name = name or (find_stem(Path(label)) if is_file else label)
        output = getattr(drive, "output", None)
        named = {quantity: NONE if text is None else text for quantity, text in (columns or {}).items()}
        table = read_table(source, partial(find_columns, named=named, output=output))
        return build_recording(name, table, unwrap, drive, named, describe_reading(named, unwrap, drive))
    except RecordingError as error:
        raise type(error)(f"{label}: {error}") from error.__cause__


def describe_reading(columns: Mapping[str, str], unwrap: bool = False, drive: ServoDrive | None = None) -> JSON:
    """Describe the arguments of `read_recording` in the words of a study, without those that are not given."""
    given = {"columns": dict(columns), "unwrap": unwrap, "drive": drive and drive.get_settings()}
    return {key: value for key, value in given.items() if value}
