"""Read arrays by name: mappings, structured arrays, NPZ, JSON, Parquet and tables of Arrow.

Elements of a vector are columns, `x[0]`.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.recording.clock import count_seconds, is_stamp
from pendulum_env.recording.columns import add_labels
from pendulum_env.recording.layout import can_be_number
from pendulum_env.recording.table import WIDEST, ColumnFinder, RawTable, convert_series, rank_words
from pendulum_env.recording.text import read_cells
from pendulum_env.recording.vocabulary import INDICES

SIGNAL = (("label", "Name"), ("values", "Data"))  # fields of a signal of Simulink and of dSPACE
QUOTES = "\"' "


def read_npz(path: Path, find: ColumnFinder) -> RawTable:
    """Read the arrays of an NPZ file, without arrays of objects, which need unpickling."""
    if not is_zipfile(path):  # NumPy's own error advises unpickling
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    arrays = {}
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        for name in archive.files:
            with suppress(ValueError):
                arrays[name] = np.asarray(archive[name])
    return build_table(arrays, find)


def read_arrays(data: Mapping[str, Any] | NDArray[Any], find: ColumnFinder) -> RawTable:
    """Read the needed columns of a mapping of arrays, which may be nested, or of a structured array.

    Entries that are None are ignored.
    """
    if not isinstance(data, Mapping):
        return build_table({name: data[name] for name in data.dtype.names or ()}, find)
    stored: dict[str, Any] = {}
    for name, value in data.items():
        if value is None or str(name).startswith("__"):
            continue
        nested = isinstance(value, Mapping)
        stored |= dict(flatten_structures(str(name), dict(value))) if nested else {str(name): np.asarray(value)}
    return build_table(stored, find)


def read_json(path: Path, find: ColumnFinder) -> RawTable:
    """Read a list of rows, a row per line, or columns by name; rows may be part of a larger object."""
    text = path.read_text(encoding="utf-8-sig")
    try:
        content = json.loads(text)
    except json.JSONDecodeError:
        content = [json.loads(line) for line in text.splitlines() if line.strip()]
    if isinstance(content, dict) and "schema" in content:
        raise RecordingError("that is no recording; `compare` and `diagnose` take a model beside one")
    return build_table({name.lstrip("."): array for name, array in flatten_structures("", _stack(content))}, find)


def _stack(value: Any) -> Any:
    """Make arrays of the lists of values in a structure, also of lists of rows."""
    if isinstance(value, dict):
        values = list(value.values())
        is_column = len(values) > WIDEST and not any(isinstance(item, dict | list) for item in values)
        return np.array(values, dtype=object) if is_column else {name: _stack(item) for name, item in value.items()}
    if not isinstance(value, list) or any(isinstance(item, dict) for item in value):
        return value
    return np.array(value, dtype=None if all(isinstance(item, int | float | list) for item in value) else object)


def flatten_structures(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and arrays of nested structures; signals of Simulink and dSPACE have the names of their labels."""
    if isinstance(value, dict):
        label, values = (next((value[key] for key in keys if key in value), None) for keys in SIGNAL)
        if isinstance(label, str) and label and hasattr(values, "shape"):
            yield from flatten_structures(f"{name.rpartition('.')[0]}.{label.strip(QUOTES)}".lstrip("."), values)
            return
        for key, inner in value.items():
            yield from flatten_structures(f"{name}.{key}" if name else key, inner)
    elif isinstance(value, list) and len(value) > WIDEST and all(isinstance(row, dict) for row in value):
        for key in dict.fromkeys(key for row in value for key in row):  # rows may lack some
            cells = [row.get(key, np.nan) for row in value]
            is_nested = any(isinstance(cell, dict) for cell in cells)
            rows = [cell if isinstance(cell, dict) else {} for cell in cells]
            yield from flatten_structures(f"{name}.{key}", rows if is_nested else np.array(cells, dtype=object))
    elif isinstance(value, list):
        for k, inner in enumerate(value[:WIDEST]):
            yield from flatten_structures(f"{name}[{k}]", inner)
    elif hasattr(value, "shape") and value.size:
        yield name, value


def build_table(stored: Mapping[str, Any], find: ColumnFinder) -> RawTable:
    """Build a table from arrays by name, reading only the needed ones; the longer side of a matrix is time.

    Sides of length 1 are dropped.
    """
    sides = {name: tuple(n for n in item.shape if n != 1) or item.shape[:1] for name, item in stored.items()}
    widths = {name: min(shape) if len(shape) == 2 else 1 for name, shape in sides.items()}
    places = [(name, k) for name, width in widths.items() if width <= WIDEST for k in range(width)]
    headers = [name if widths[name] == 1 else f"{name}[{k}]" for name, k in places]
    load = cache(lambda name: stored[name][()])
    texts = {name: _find_first_text(item) for name, item in stored.items()}

    def is_number(name: str) -> bool:
        kind, first = stored[name].dtype.kind, texts[name]
        if first is None:  # arrays of objects may have numbers, Arrow columns have texts
            return kind in "iuf" or (kind == "O" and not isinstance(stored[name], Series))
        return can_be_number(first, name)

    text_columns = [k for k, (name, _) in enumerate(places) if math.prod(sides[name]) < 2 or not is_number(name)]
    cells = [texts[name] or "" for name, _ in places]
    date_columns = [k for k, (name, _) in enumerate(places) if stored[name].dtype.kind == "M" or is_stamp(cells[k])]
    columns = add_labels(find(headers, text_columns=text_columns, date_columns=date_columns), headers, cells)
    values: dict[str, Array] = {}
    date, has_texts = None, False
    for quantity, column in columns.items():
        name, k = places[column.index]
        shape, dtype = sides[name], stored[name].dtype
        is_date = quantity == "time" and dtype.kind in "mM"
        is_label = quantity == "segment" and texts[name] is not None
        if not (is_date or is_label or dtype.kind in "biufUO") or len(shape) not in (1, 2):
            raise RecordingError(
                f"array {name!r} ({quantity}) has type {dtype} and shape {shape}: "
                "store real numbers, one of each per sample"
            )
        array = np.reshape(load(name), shape)
        if array.ndim == 2:
            array = array[:, k] if shape[0] >= shape[1] else array[k]
        if is_date:
            array, date = count_seconds(array)
        if is_label:
            array = rank_words(array)
        if dtype.kind in "UO" and not is_label and any(isinstance(cell, str) for cell in array):
            values[quantity], has_texts = array, True
        else:
            values[quantity] = np.array(array, dtype=np.float64)  # copy of the caller's array
    if len({len(array) for array in values.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in values.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    if has_texts:
        text_table = read_cells(columns, values)
        return replace(text_table, date=text_table.date or date)
    return RawTable(columns, values, date=date)


def _find_first_text(item: Any) -> str | None:
    """Return the first cell of an array of texts, or None for other arrays."""
    if item.dtype.kind not in "UO" or not math.prod(item.shape):
        return None
    first = (item.head if isinstance(item, Series) else item[()]).flat[0]
    return first if isinstance(first, str) else None


@dataclass(frozen=True)
class Series:
    """Column with the interface of an array, read at the first use except for its first row."""

    head: NDArray[Any]  # first row (1,), or (1, K) for vectors
    rows: int
    read: Callable[[], NDArray[Any]]

    @property
    def dtype(self) -> np.dtype[Any]:
        """Return the type of the cells."""
        return self.head.dtype

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape, (N,) or (N, K)."""
        return (self.rows, *self.head.shape[1:])

    def __getitem__(self, key: tuple[()]) -> NDArray[Any]:
        return self.read()


def read_frame(data: Any, find: ColumnFinder) -> RawTable:
    """Read the needed columns of a table in memory; an unnamed index of times becomes the time."""
    try:
        table = pa.table(data)
    except (pa.ArrowInvalid, pa.ArrowTypeError):  # a pandas column of mixed types
        return read_arrays({name: data[name].to_numpy() for name in data.columns}, find)
    index = INDICES[1]  # unnamed index of pandas
    if index in table.column_names and (pa.types.is_temporal(kind := table[index].type) or pa.types.is_floating(kind)):
        table = table.rename_columns(["time" if name == index else name for name in table.column_names])
    return build_table(_list_series(table.slice(0, 1), len(table), table.column), find)


def read_parquet(path: Path, find: ColumnFinder) -> RawTable:
    """Read the needed columns of a Parquet file."""
    import pyarrow.parquet as pq  # slow import

    with pq.ParquetFile(path, pre_buffer=False) as file:
        head = next(file.iter_batches(1), None)

        def read(name: str) -> pa.ChunkedArray:
            return file.read(columns=[name], use_threads=False)[name]

        return build_table(_list_series(head, file.metadata.num_rows, read), find)


def _list_series(
    head: pa.Table | pa.RecordBatch | None, rows: int, read: Callable[[str], pa.ChunkedArray]
) -> dict[str, Series]:
    """Return the columns of an Arrow table by name, from its first row."""
    if not rows or head is None:
        raise RecordingError("the table has no rows: record it again")

    def load(name: str) -> NDArray[Any]:
        return convert_series(read(name))

    return {name: Series(convert_series(head[name]), rows, partial(load, name)) for name in head.schema.names}
