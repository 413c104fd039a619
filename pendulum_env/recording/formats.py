"""Read columns of a file by its suffix, or of a table in memory by its type."""

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pendulum_env.errors import FileError, RecordingError, shorten_error
from pendulum_env.reading import check_size, quote_value
from pendulum_env.recording.arrays import read_arrays, read_frame, read_json, read_npz, read_parquet
from pendulum_env.recording.bags import is_bag, read_bag
from pendulum_env.recording.matlab import read_hdf5, read_mat
from pendulum_env.recording.table import ColumnFinder, RawTable
from pendulum_env.recording.text import read_csv, read_excel

READERS: dict[str, Callable[[Path, ColumnFinder], RawTable]] = {
    ".csv": read_csv,
    ".csv.gz": read_csv,
    ".tsv": read_csv,
    ".txt": read_csv,
    ".parquet": read_parquet,
    ".npz": read_npz,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".xlsx": read_excel,
    ".xls": read_excel,
    ".ods": read_excel,
    ".mcap": read_bag,
    ".bag": read_bag,
    ".db3": read_bag,
    ".dat": read_csv,
    ".lvm": read_csv,
    ".log": read_csv,
    ".json": read_json,
    ".jsonl": read_json,
}
RECIPES = {  # remedies for unsupported formats
    ".npy": "name its columns: numpy.savez('run.npz', time=..., position=..., torque=...)",
    ".pkl": "write it with pandas' to_parquet, since reading a pickle runs what is in it",
    ".wpilog": "export it by AdvantageScope: File, Export Data, Format CSV, Timestamps All Changes",
    ".hoot": "convert it by owlet to .wpilog, then export that by AdvantageScope as CSV",
    ".ulg": "export it by ulog2csv of pyulog",
    ".tdms": "export it by npTDMS: TdmsFile('run.tdms').as_dataframe().to_parquet('run.parquet')",
    ".mf4": "export it by asammdf: MDF('run.mf4').to_dataframe().to_parquet('run.parquet')",
    ".toml": "that is a study: read_study reads its recordings",
}


class ArrowStream(Protocol):
    """Table with Arrow's interface: of pyarrow, Polars, DuckDB, and pandas 2.2 or later."""

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """Export the table."""
        ...


Readable = str | os.PathLike[str] | Mapping[str, Any] | ArrowStream | NDArray[Any]  # arrays: structured


def is_data(source: object) -> bool:
    """Return whether an object is a table in memory for `read_table`; dataclasses are not."""
    is_mapping = isinstance(source, Mapping) and not is_dataclass(source)
    is_structured = isinstance(source, np.ndarray) and bool(source.dtype.names)
    return is_mapping or is_structured or hasattr(source, "__arrow_c_stream__")


def is_readable(source: object) -> bool:
    """Return whether an object has a type that `read_recording` accepts."""
    return isinstance(source, str | os.PathLike) or is_data(source)


def get_label(source: Readable, name: str | None = None) -> str:
    """Return the name of a source for messages: the path, or the name of a table in memory."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else name or "recording"


def find_format(path: Path, suffixes: Collection[str]) -> str:
    """Return the suffix in `suffixes` of a file's format, `.db3` for a folder with a bag."""
    if ".db3" in suffixes and is_bag(path):
        return ".db3"
    name = path.name.lower()
    for suffix in suffixes:
        if name.endswith(suffix) and len(name) > len(suffix):
            return suffix
    if os.path.isdir(path):
        raise RecordingError("is a folder: name a recording in it, or all of them with `survey`")
    recipe = RECIPES.get(path.suffix.lower(), "convert the recording to one of these")
    raise RecordingError(f"the name does not end in {', '.join(suffixes)}: {recipe}")


def find_stem(path: Path) -> str:
    """Return the name of a file without the suffix of its format."""
    return path.name if is_bag(path) else path.name[: -len(find_format(path, READERS))]


def read_table(source: Readable, find: ColumnFinder) -> RawTable:
    """Read the needed columns of a file or table with raw values; turn errors of libraries into RecordingErrors.

    Raises:
        TypeError: if the source has another type.
        RecordingError: if the source cannot be read; the message lacks the file's name.
    """
    if not isinstance(source, str | os.PathLike):
        if not is_data(source):
            raise TypeError(f"{quote_value(source)} is no table: give a path, a mapping of arrays or a data frame")
        try:
            return read_arrays(source, find) if isinstance(source, Mapping | np.ndarray) else read_frame(source, find)
        except RecordingError:
            raise
        except Exception as error:
            raise RecordingError(f"not a readable table ({shorten_error(error)}): give arrays of numbers") from error
    path = Path(source)
    ending = find_format(path, READERS)
    if not os.path.exists(path):
        raise RecordingError("there is no such file: check the path")
    try:
        for file in path.iterdir() if is_bag(path) else [path]:
            check_size(file)
        return READERS[ending](path, find)
    except RecordingError:
        raise
    except FileError as error:
        raise RecordingError(str(error).removeprefix(f"{path}: ")) from None
    except UnicodeEncodeError:
        raise RecordingError("its name is no UTF-8, which libraries need: rename it") from None
    except Exception as error:  # damaged files raise errors of zlib, zipfile, NumPy or Arrow
        raise RecordingError(f"not a readable {ending} file ({shorten_error(error)}): export it again") from error
