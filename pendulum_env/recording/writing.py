"""Write recordings without loss of precision."""

import gzip
import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.files import replace_file
from pendulum_env.recording.formats import find_format
from pendulum_env.recording.record import Recording


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
