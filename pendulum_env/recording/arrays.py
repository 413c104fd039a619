"""NPZ, MATLAB, HDF5, Parquet and tables in memory: arrays by name, the elements of a vector as columns, `x[0]`."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, is_dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
import pyarrow as pa
import scipy
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.reading import quote_value
from pendulum_env.recording.clock import count_seconds
from pendulum_env.recording.columns import add_labels
from pendulum_env.recording.layout import can_be_number
from pendulum_env.recording.table import WIDEST, ColumnFinder, RawTable, convert_series, require_module
from pendulum_env.recording.text import rank_words, read_cells
from pendulum_env.recording.vocabulary import INDICES

SIGNAL = (("label", "Name"), ("values", "Data"))  # fields of a signal of Simulink and of dSPACE
QUOTES = "\"' "
DESCRIPTIONS = ("dimensions", "name")  # fields of MATLAB structures that hold no samples


def read_npz(path: Path, find: ColumnFinder) -> RawTable:
    """Read arrays; those of objects, which would have to be unpickled, are passed over."""
    if not is_zipfile(path):  # NumPy would advise to unpickle it
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    arrays = {}
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        for name in archive.files:
            with suppress(ValueError):
                arrays[name] = np.asarray(archive[name])
    return _build_table(arrays, find)


def read_mat(path: Path, find: ColumnFinder) -> RawTable:
    """Read MATLAB files: up to v7 by SciPy, v7.3 as HDF5; fields of structures are named `run.position`."""
    with path.open("rb") as file:
        if file.read(128).startswith(b"MATLAB 7.3"):
            return read_hdf5(path, find)

    scipy.io.whosmat(path)  # refuses a damaged file that crashes loadmat
    content = scipy.io.loadmat(path, simplify_cells=True)
    return _build_table(
        dict(_flatten("", {name: value for name, value in content.items() if not name.startswith("__")})), find
    )


def _flatten(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """List arrays in nested structures; signals of Simulink and dSPACE are named by their labels."""
    if isinstance(value, dict):
        label, values = (next((value[key] for key in keys if key in value), None) for keys in SIGNAL)
        if isinstance(label, str) and label and hasattr(values, "shape"):
            yield from _flatten(f"{name.rpartition('.')[0]}.{label.strip(QUOTES)}".lstrip("."), values)
            return
        for key, inner in value.items():
            yield from _flatten(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list) and len(value) > WIDEST and all(isinstance(row, dict) for row in value):
        for key in value[0]:
            yield from _flatten(f"{name}.{key}", np.array([row.get(key, np.nan) for row in value], dtype=object))
    elif isinstance(value, list):
        for k, inner in enumerate(value[:WIDEST]):
            yield from _flatten(f"{name}[{k}]", inner)
    elif hasattr(value, "shape") and value.size:
        yield name, value


def read_data(data: Any, find: ColumnFinder) -> RawTable:
    """Read the columns in need of a mapping of arrays, a structured array, or a table that Arrow understands.

    Entries of a mapping that are None are left out.
    """
    if isinstance(data, Mapping):
        given = {str(name): value for name, value in data.items() if value is not None}
        nested = ((name, value) for name, value in given.items() if not name.startswith("__"))
        return _build_table({path: own for name, value in nested for path, own in _collect_arrays(name, value)}, find)
    if isinstance(data, np.ndarray) and data.dtype.names:
        return _build_table({name: data[name] for name in data.dtype.names}, find)
    if hasattr(data, "__arrow_c_stream__"):
        try:
            table = pa.table(data)
        except (pa.ArrowInvalid, pa.ArrowTypeError):  # pandas: a column of texts and numbers
            return read_data({name: data[name].to_numpy() for name in data.columns}, find)
    else:
        raise TypeError(f"{quote_value(data)} is no table: give a path, a mapping of arrays or a data frame")
    index = INDICES[1]  # of pandas, where it has no name
    if index in table.column_names and (pa.types.is_temporal(kind := table[index].type) or pa.types.is_floating(kind)):
        table = table.rename_columns(["time" if name == index else name for name in table.column_names])
    return _build_table(_list_series(table.slice(0, 1), len(table), table.column), find)


def _collect_arrays(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """List the arrays of one entry of a mapping."""
    if isinstance(value, Mapping):
        yield from _flatten(name, dict(value))
    else:
        yield name, np.asarray(value)


def is_data(given: object) -> bool:
    """Return whether something is a table in memory that `read_data` reads; a dataclass, such as a result, is none."""
    is_mapping = isinstance(given, Mapping) and not is_dataclass(given)
    is_structured = isinstance(given, np.ndarray) and bool(given.dtype.names)
    return is_mapping or is_structured or hasattr(given, "__arrow_c_stream__")


def read_hdf5(path: Path, find: ColumnFinder) -> RawTable:
    """Read datasets of HDF5 by their paths, `run/position`; external links are not followed.

    Of MATLAB 7.3, structures and their arrays are named as in older files: `run.position`, `out.signals[0].values[1]`.
    Texts, names and sizes are no columns.
    """
    require_module("h5py")
    import h5py

    with path.open("rb") as start:
        is_matlab = start.read(128).startswith(b"MATLAB 7.3")
    with h5py.File(path, "r") as file:
        return _build_table(
            dict(_flatten("", _read_matlab_value(file)) if is_matlab else _collect_datasets(file, "")), find
        )


def _collect_datasets(group: Any, path: str) -> Iterator[tuple[str, Any]]:
    for name, item in _find_members(group):
        if hasattr(item, "keys"):
            yield from _collect_datasets(item, f"{path}{name}/")
        else:
            yield path + name, item


def _find_members(group: Any) -> Iterator[tuple[str, Any]]:
    """Map names to groups and datasets of a group, without links and external datasets."""
    import h5py

    for name in group:
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            item = group[name]
            if isinstance(item, h5py.Group) or (isinstance(item, h5py.Dataset) and _is_whole(item)):
                yield name, item


def _is_whole(dataset: Any) -> bool:
    return dataset.shape is not None and not (dataset.external or dataset.is_virtual)


def _read_matlab_value(item: Any) -> Any:
    """Convert a value of MATLAB 7.3 to that of older files; numeric datasets stay unread.

    An array of structures is a group of fields, a cell is a dataset: they hold references to what they contain.
    """
    import h5py

    if isinstance(item, h5py.Group):
        fields = {name: own for name, own in _find_members(item) if name[0] != "#" and name not in DESCRIPTIONS}
        arrays = {name: own for name, own in fields.items() if _has_references(own) and "MATLAB_class" not in own.attrs}
        rows = zip(*(_follow_reference(own) for own in arrays.values()), strict=True)
        structures = [dict(zip(arrays, row, strict=True)) for row in rows]
        return structures or {name: _read_matlab_value(own) for name, own in fields.items()}
    kind = item.attrs.get("MATLAB_class")
    if "MATLAB_empty" in item.attrs or kind == b"function_handle" or not _is_whole(item):
        return None
    if kind == b"char":
        return "".join(map(chr, item[()].flat))
    if _has_references(item):
        return _follow_reference(item)
    return item[()].item() if item.size == 1 else item


def _has_references(item: Any) -> bool:
    import h5py

    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is h5py.Reference


def _follow_reference(item: Any) -> list[Any]:
    return [_read_matlab_value(item.file[reference]) for reference in item[()].flat]


def _build_table(stored: Mapping[str, Any], find: ColumnFinder) -> RawTable:
    """Build a table from arrays by name, of which those are read that are needed; the longer side of a matrix is time.

    Sides of length 1 are dropped.
    """
    sides = {name: tuple(n for n in item.shape if n != 1) or item.shape[:1] for name, item in stored.items()}
    widths = {name: min(shape) if len(shape) == 2 else 1 for name, shape in sides.items()}
    places = [(name, k) for name, width in widths.items() if width <= WIDEST for k in range(width)]
    headers = [name if widths[name] == 1 else f"{name}[{k}]" for name, k in places]
    load = cache(lambda name: stored[name][()])
    firsts = {name: _find_first_text(item) for name, item in stored.items()}

    def is_number(name: str) -> bool:
        kind, first = stored[name].dtype.kind, firsts[name]
        return kind in "iuf" or (kind in "UO" and (first is None or can_be_number(first, name)))

    wordy = [k for k, (name, _) in enumerate(places) if math.prod(sides[name]) < 2 or not is_number(name)]
    columns = add_labels(find(headers, wordy=wordy), headers, [firsts[name] or "" for name, _ in places])
    values: dict[str, Array] = {}
    date, texts = None, False
    for quantity, column in columns.items():
        name, k = places[column.index]
        shape, dtype = sides[name], stored[name].dtype
        dates, labels = quantity == "time" and dtype.kind in "mM", quantity == "segment" and firsts[name] is not None
        if not (dates or labels or dtype.kind in "biufUO") or len(shape) not in (1, 2):
            raise RecordingError(
                f"array {name!r} ({quantity}) has type {dtype} and shape {shape}: "
                "store real numbers, one of each per sample"
            )
        array = np.reshape(load(name), shape)
        if array.ndim == 2:
            array = array[:, k] if shape[0] >= shape[1] else array[k]
        if dates:
            array, date = count_seconds(array)
        if labels:
            array = rank_words(array)
        if dtype.kind in "UO" and not labels and any(isinstance(cell, str) for cell in array):
            values[quantity], texts = array, True
        else:
            values[quantity] = np.array(array, dtype=np.float64)  # the caller's stays as it is
    if len({len(array) for array in values.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in values.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    if texts:
        read = read_cells(headers, columns, values)
        return replace(read, date=read.date or date)
    return RawTable(headers, columns, values, date=date)


def _find_first_text(item: Any) -> str | None:
    """Find the first cell of an array of texts; None of others."""
    if item.dtype.kind not in "UO" or not math.prod(item.shape):
        return None
    first = (item.head if isinstance(item, Series) else item[()]).flat[0]
    return first if isinstance(first, str) else None


@dataclass(frozen=True)
class Series:
    """Column of an Arrow table with the interface of an array: only its head is read before it is needed."""

    head: NDArray[Any]  # (1,), or (1, K) of vectors
    rows: int
    read: Callable[[], pa.ChunkedArray]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Return the type of the cells."""
        return self.head.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the number of rows, and of elements of a vector."""
        return (self.rows, *self.head.shape[1:])

    def __getitem__(self, key: tuple[()]) -> NDArray[Any]:
        return convert_series(self.read())


def read_parquet(path: Path, find: ColumnFinder) -> RawTable:
    """Read the columns in need of a Parquet file."""
    import pyarrow.parquet as pq  # takes a while to import

    with pq.ParquetFile(path, pre_buffer=False) as file:
        head = next(file.iter_batches(1), None)

        def read(name: str) -> pa.ChunkedArray:
            return file.read(columns=[name], use_threads=False)[name]

        return _build_table(_list_series(head, file.metadata.num_rows, read), find)


def _list_series(
    head: pa.Table | pa.RecordBatch | None, rows: int, read: Callable[[str], pa.ChunkedArray]
) -> dict[str, Series]:
    """List the columns of an Arrow table by its first row."""
    if not rows or head is None:
        raise RecordingError("the table has no rows: record it again")
    return {name: Series(convert_series(head[name]), rows, partial(read, name)) for name in head.schema.names}
