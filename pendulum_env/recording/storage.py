"""Reading recordings from files, with every doubt raised at once, and writing them so that they read back exactly."""

import gzip
import io
import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from pendulum_env._typing import Array
from pendulum_env.recording import checks
from pendulum_env.recording.binary import read_npz, read_parquet
from pendulum_env.recording.record import Recording, RecordingError
from pendulum_env.recording.sampling import refuse_bad_time, uniform
from pendulum_env.recording.table import Named, Table, one_line
from pendulum_env.recording.text import read_csv

READERS: dict[str, Callable[[Path, Named], Table]] = {
    ".csv": read_csv,
    ".csv.gz": read_csv,
    ".parquet": read_parquet,
    ".npz": read_npz,
}


def read_recording(
    path: str | os.PathLike[str], *, unwrap: bool = False, columns: Mapping[str, str] | None = None
) -> Recording:
    """Read a CSV (also .csv.gz), Parquet or NPZ file with columns time, position, torque and perhaps velocity.

    Names are taken as in `columns.py`, their units converted to s, rad, N m, rad/s; slightly uneven time is made
    uniform as in `sampling.py`. Whatever was changed is said in the recording's `notes`.

    Args:
        unwrap: undo jumps of 2 pi in position, which are refused otherwise.
        columns: which column is which quantity, where the file's own names do not tell, with a unit behind a colon
            where it is not SI: `{"position": "Winkel:deg", "torque": "torque commanded"}`. Units are s, ms, us, ns;
            rad, mrad, deg, rev; rad/s, deg/s, rpm, rev/s; Nm, mNm, Ncm.

    Raises:
        RecordingError: if the file cannot be read or its content cannot be trusted: one sentence with the file, the
            data row (from 1, header and blank lines not counted) where there is one, the reason and the remedy.
    """
    path = Path(path)
    try:
        suffix = _suffix(path)
        return _recording(path.name[: -len(suffix)], _table(path, suffix, columns), unwrap)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error.__cause__


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write columns time, position, torque and perhaps velocity, in the format that the name's ending asks for.

    Floats are written exactly. The file appears whole or not at all: it is written beside its place, then moved there.

    Raises:
        RecordingError: if the ending is unknown or the file cannot be written.
    """
    path = Path(path)
    columns = {"time": recording.time, "position": recording.position, "torque": recording.torque}
    if recording.velocity is not None:
        columns["velocity"] = recording.velocity
    try:
        write = WRITERS[_suffix(path)]
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            write(file, columns)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror}): choose another place") from error
    finally:
        temporary.unlink(missing_ok=True)


def _suffix(path: Path) -> str:
    name = path.name.lower()
    for suffix in READERS:
        if name.endswith(suffix) and len(name) > len(suffix):
            return suffix
    raise RecordingError(f"the name does not end in {', '.join(READERS)}: convert the recording to one of these")


def _table(path: Path, suffix: str, named: Named) -> Table:
    """Columns as they stand in the file; whatever the libraries below raise becomes a RecordingError."""
    try:
        if path.is_dir():
            raise RecordingError("it is a directory: name a file in it")
        if not path.exists():
            raise RecordingError("there is no such file: check the path")
        return READERS[suffix](path, named)
    except RecordingError:
        raise
    except Exception as error:  # a damaged file may fail anywhere in zlib, zipfile, numpy or arrow
        raise RecordingError(
            f"it cannot be read as {suffix} ({one_line(error)}): it may be damaged, export it again"
        ) from error


def _recording(name: str, table: Table, unwrap: bool) -> Recording:
    """Convert to SI, refuse what cannot be true, make time uniform."""
    notes = tuple(note for column in table.columns.values() for note in column.notes)
    values = table.values
    for quantity, column in table.columns.items():
        values[quantity] *= column.scale
    checks.refuse_not_finite(values)
    checks.refuse_too_few(values["time"])
    refuse_bad_time(values["time"])
    checks.refuse_too_short(values["time"])
    checks.refuse_still(values["position"])
    checks.refuse_jumps(values["position"], allow_wrapped=unwrap)
    if unwrap:
        values["position"], unwrapping = _unwrapped(values["position"])
        notes += unwrapping

    values, resampling = uniform(values)
    recording = Recording(name, **values, notes=notes + resampling)
    checks.refuse_too_fast(recording.rate, recording.position)
    if recording.velocity is not None:
        checks.refuse_foreign_velocity(recording.rate, recording.position, recording.velocity)
    if table.columns["position"].unit is None:  # a unit in the name is trusted
        checks.refuse_degrees(recording.rate, recording.position, recording.torque)
    return recording


def _unwrapped(position: Array) -> tuple[Array, tuple[str, ...]]:
    unwrapped = np.unwrap(position)
    jumps = int(np.count_nonzero(np.abs(np.diff(position)) > np.pi))
    return unwrapped, ((f"position unwrapped at {jumps} jumps of 2 pi",) if jumps else ())


def _write_csv(file: io.BufferedIOBase, columns: dict[str, Array]) -> None:
    file.write((",".join(columns) + "\n").encode())
    pacsv.write_csv(pa.table(columns), file, pacsv.WriteOptions(include_header=False))  # shortest exact decimals


def _write_gzip(file: io.BufferedIOBase, columns: dict[str, Array]) -> None:
    # without name and time of writing, the same data give the same bytes
    with gzip.GzipFile(filename="", mode="wb", fileobj=file, compresslevel=5, mtime=0) as compressed:
        _write_csv(compressed, columns)


def _write_parquet(file: io.BufferedIOBase, columns: dict[str, Array]) -> None:
    pq.write_table(pa.table(columns), file)


def _write_npz(file: io.BufferedIOBase, columns: dict[str, Array]) -> None:
    np.savez_compressed(file, allow_pickle=False, **columns)


WRITERS: dict[str, Callable[[io.BufferedIOBase, dict[str, Array]], None]] = {
    ".csv": _write_csv,
    ".csv.gz": _write_gzip,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
