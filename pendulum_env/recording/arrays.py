"""NPZ, MATLAB, HDF5, Parquet and tables in memory: arrays by name, the elements of a vector as columns, `x[0]`."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass, replace
from functools import cache
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
from pendulum_env.recording.table import (
    WIDEST,
    ColumnFinder,
    RawTable,
    convert_numbers,
    find_first_date,
    is_text,
    require_module,
)
from pendulum_env.recording.text import can_be_number, read_cells
from pendulum_env.recording.vocabulary import INDICES

NUMBER_TYPES = (pa.types.is_boolean, pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal)
SIGNAL = (("label", "Name"), ("values", "Data"))  # fields of a signal of Simulink and of dSPACE
QUOTES = "\"' "
DESCRIPTIONS = ("dimensions", "name")  # fields of MATLAB structures that hold no samples


def read_npz(path: Path, find: ColumnFinder) -> RawTable:
    """Read arrays, without unpickling."""
    if not is_zipfile(path):  # NumPy would advise to unpickle it
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return _build_table({name: np.asarray(archive[name]) for name in archive.files}, find)


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
    return _read_arrow(
        table.schema, lambda names: table.select(names).slice(0, 1) if len(table) else None, table.select, find
    )


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
    """Build a table from arrays by name, HDF5 datasets still unread; the longer side of a matrix is time.

    Sides of length 1 are dropped.
    """
    sides = {name: tuple(n for n in item.shape if n != 1) or item.shape[:1] for name, item in stored.items()}
    widths = {name: min(shape) if len(shape) == 2 else 1 for name, shape in sides.items()}
    places = [(name, k) for name, width in widths.items() if width <= WIDEST for k in range(width)]
    headers = [name if widths[name] == 1 else f"{name}[{k}]" for name, k in places]
    load = cache(lambda name: stored[name][()])

    def is_number(name: str) -> bool:
        kind = stored[name].dtype.kind
        return kind in "iufO" or (kind == "U" and can_be_number(str(load(name).flat[0]), name))

    wordy = [k for k, (name, _) in enumerate(places) if math.prod(sides[name]) < 2 or not is_number(name)]
    cells = [str(load(name).flat[0]) if stored[name].dtype.kind == "U" and sides[name] else "" for name, _ in places]
    columns = add_labels(find(headers, wordy=wordy), headers, cells)
    values: dict[str, Array] = {}
    date, texts = None, False
    for quantity, column in columns.items():
        name, k = places[column.index]
        shape, dtype = sides[name], stored[name].dtype
        dates, labels = quantity == "time" and dtype.kind in "mM", quantity == "segment" and dtype.kind in "UO"
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
            array = np.unique(array.astype(str), return_inverse=True)[1]
        if dtype.kind in "UO" and not labels and any(isinstance(cell, str) for cell in array):
            values[quantity], texts = array, True
        else:
            values[quantity] = np.array(array, dtype=np.float64)  # the caller's stays as it is
    if len({len(array) for array in values.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in values.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    if texts:
        read = read_cells(headers, columns, {quantity: _make_cells(array) for quantity, array in values.items()})
        return replace(read, date=read.date or date)
    return RawTable(headers, columns, values, date=date)


def _make_cells(values: NDArray[Any]) -> pa.ChunkedArray:
    """Make an Arrow column of the texts or numbers of an array."""
    if values.dtype.kind not in "UO":
        return pa.chunked_array([values])
    return pa.chunked_array([[None if cell is None or cell != cell else str(cell) for cell in values]], pa.string())


def read_parquet(path: Path, find: ColumnFinder) -> RawTable:
    """Read the columns in need of a Parquet file."""
    import pyarrow.parquet as pq  # takes a while to import

    with pq.ParquetFile(path, pre_buffer=False) as file:

        def first(names: list[str]) -> Any:
            return next(file.iter_batches(batch_size=1, columns=names), None)

        return _read_arrow(file.schema_arrow, first, lambda names: file.read(columns=names, use_threads=False), find)


def _read_arrow(
    schema: pa.Schema, first: Callable[..., Any], read: Callable[..., pa.Table], find: ColumnFinder
) -> RawTable:
    """Read the columns in need of an Arrow table: `first` gives a row of named columns, `read` all rows."""
    vectors = [
        field.name for field in schema if isinstance(field.type, pa.ListType | pa.LargeListType | pa.FixedSizeListType)
    ]
    texts = [field.name for field in schema if is_text(field.type)]
    row = first([*vectors, *texts]) if vectors or texts else None
    widths = {name: min(len(row[name][0].as_py() or ()), WIDEST) for name in vectors if row}
    places = [(name, k) for name in schema.names for k in (range(widths.get(name, 0)) if name in vectors else [None])]
    headers = [name if k is None else f"{name}[{k}]" for name, k in places]
    kinds = [schema.field(name).type for name, _ in places]

    def is_word(name: str, kind: pa.DataType) -> bool:
        cell = row[name][0].as_py() if row and is_text(kind) else None
        return not (_is_number(kind) or (cell is not None and can_be_number(cell, name)))

    wordy = [k for k, (name, place) in enumerate(places) if place is None and is_word(name, kinds[k])]
    cells = [str(row[name][0].as_py() or "") if row and name in texts else "" for name, _ in places]
    columns = add_labels(find(headers, wordy=wordy), headers, cells)
    table = read(list(dict.fromkeys(places[column.index][0] for column in columns.values())))
    found = {quantity: _select_series(table, *places[column.index]) for quantity, column in columns.items()}
    for quantity, series in found.items():
        if not (_is_number(series.type) or is_text(series.type) or (quantity == "time" and _is_date(series.type))):
            raise RecordingError(
                f"column {columns[quantity].header!r} ({quantity}) has type {series.type}: "
                "store it as a floating-point number in SI"
            )
    if any(is_text(series.type) for quantity, series in found.items() if quantity != "segment"):
        return read_cells(headers, columns, found)
    values = {quantity: convert_numbers(series) for quantity, series in found.items()}
    return RawTable(headers, columns, values, date=find_first_date(found["time"]))


def _select_series(table: pa.Table, name: str, k: int | None) -> pa.ChunkedArray:
    """Select a column of a table, or element k of a vector."""
    if k is None:
        return table[name]
    import pyarrow.compute as pc  # takes a while to import

    return pc.list_element(table[name], k)


def _is_date(kind: pa.DataType) -> bool:
    return bool(pa.types.is_timestamp(kind) or pa.types.is_duration(kind))


def _is_number(kind: pa.DataType) -> bool:
    return any(test(kind) for test in NUMBER_TYPES)
