"""Read columns of a file by its suffix, or of a table in memory by its type."""

import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.errors import FileError, RecordingError, shorten_error
from pendulum_env.reading import check_size, quote_value
from pendulum_env.recording.arrays import build_table, read_arrays, read_frame, read_json, read_npz, read_parquet
from pendulum_env.recording.bags import is_bag, read_bag
from pendulum_env.recording.columns import FileColumn, guess_columns
from pendulum_env.recording.lerobot import find_dataset, read_episode
from pendulum_env.recording.matlab import read_hdf5, read_mat
from pendulum_env.recording.table import ColumnFinder, RawTable
from pendulum_env.recording.text import read_csv, read_excel

DATASET = "meta/info.json"  # of a dataset of LeRobot
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
    DATASET: read_episode,
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
    """Return the suffix in `suffixes` of a file's format; of a folder, the file that tells it."""
    if ".db3" in suffixes and is_bag(path):
        return ".db3"
    if DATASET in suffixes and find_dataset(path):
        return DATASET
    if suffix := _find_suffix(path.name, suffixes):
        return suffix
    if os.path.isdir(path):
        raise RecordingError("is a folder: name a recording in it, or all of them with `survey`")
    recipe = RECIPES.get(path.suffix.lower(), "convert the recording to one of these")
    raise RecordingError(f"the name does not end in {', '.join(suffixes)}: {recipe}")


def _find_suffix(name: str, suffixes: Iterable[str]) -> str:
    """Return the first of some suffixes that a file's name has, after at least one letter; empty if it has none."""
    fitting = (suffix for suffix in suffixes if name.lower().endswith(suffix) and len(name) > len(suffix))
    return next(fitting, "")


def is_there(path: Path) -> bool:
    """Return whether the files or the folder of a recording exist."""
    return find_dataset(path) is not None or all(map(os.path.exists, _list_parts(path)))


def _list_parts(path: Path) -> list[Path]:
    """List the files of a path: `states.csv+goals.csv` are two files of one folder."""
    names = path.name.split("+")
    are_files = len(names) == 2 and all(_find_suffix(name, READERS) for name in names)
    return [path] if not are_files or os.path.exists(path) else [path.with_name(name) for name in names]


def _join_goals(states: Path, goals: Path) -> dict[str, Array]:
    """Join the rows of two files with equal times; names of columns of the second one begin with `goal_`."""
    (time, columns), (goal_time, others) = map(_read_all, (states, goals))
    _, rows, goal_rows = np.intersect1d(time, goal_time, return_indices=True)
    if 2 * len(rows) < min(len(time), len(goal_time)):
        raise RecordingError(
            f"only {len(rows)} of {len(time)} times are those of a row of {goals.name}: write both in the same rows"
        )
    goal_columns = {name if name.startswith("goal") else f"goal_{name}": x[goal_rows] for name, x in others.items()}
    return {"time": time[rows]} | {name: x[rows] for name, x in columns.items()} | goal_columns


def _read_all(path: Path) -> tuple[Array, dict[str, Array]]:
    """Read the time (N,) [s], since 1970 if the file has dates, and the other columns of numbers of a file."""

    def select(
        headers: Sequence[str], *, text_columns: Collection[int] = (), date_columns: Collection[int] = ()
    ) -> dict[str, FileColumn]:
        clock = guess_columns(headers).get("time", headers[0])
        kept = [k for k, header in enumerate(headers) if k not in text_columns or header.strip() == clock.strip()]
        kept.sort(key=lambda k: headers[k].strip() != clock.strip())
        names = ["time", "position", *map(str, kept)]  # readers treat time and position in a special way
        return {name: FileColumn(name, headers[k].strip(), k, None) for name, k in zip(names, kept, strict=False)}

    table = read_table(path, select)
    start = table.date.timestamp() if table.date else 0.0
    others = {table.columns[name].header: x for name, x in table.values.items() if name != "time"}
    return np.round(table.values["time"] + start, 6), others


def find_stem(path: Path) -> str:
    """Return the name of a file without the suffix of its format."""
    is_folder = is_bag(path) or find_dataset(path)
    return path.name if is_folder else path.name[: -len(find_format(path, READERS))]


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
    if len(parts := _list_parts(path)) > 1:
        return build_table(_join_goals(*parts), find)
    ending = find_format(path, READERS)
    if not is_there(path):
        raise RecordingError("there is no such file: check the path")
    try:
        for file in path.iterdir() if is_bag(path) else [] if ending == DATASET else [path]:
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
