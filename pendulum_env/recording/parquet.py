"""Parquet, with vectors as columns of their own: `observation.state[0]`."""

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import Find, Table, numbers

LONGEST = 64  # elements of a vector


def read_parquet(path: Path, find: Find = find_columns) -> Table:
    """The columns in need.

    Raises:
        RecordingError: if a column is missing or does not hold numbers.
    """
    with pq.ParquetFile(path, pre_buffer=False) as file:
        places = _places(file)
        headers = [name if k is None else f"{name}[{k}]" for name, k in places]
        columns = find(headers)
        chosen = [places[column.index] for column in columns.values()]
        table = file.read(columns=list(dict.fromkeys(name for name, _ in chosen)), use_threads=False)
    values = {}
    for (name, k), column in zip(chosen, columns.values(), strict=True):
        series = table[name] if k is None else pc.list_element(table[name], k)
        kind = series.type
        stamps = pa.types.is_timestamp(kind) and column.quantity == "time"
        if not (stamps or pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
            raise RecordingError(
                f"column {column.header!r} ({column.quantity}) has type {kind}: "
                "store it as a floating-point number in SI"
            )
        values[column.quantity] = numbers(series)
    return Table(headers, columns, values)


def _places(file: pq.ParquetFile) -> list[tuple[str, int | None]]:
    """Name and element of every column, the elements of vectors one by one."""
    schema = file.schema_arrow
    vectors = [name for name in schema.names if _is_vector(schema.field(name).type)]
    first = next(file.iter_batches(batch_size=1, columns=vectors), None) if vectors else None
    places: list[tuple[str, int | None]] = []
    for name in schema.names:
        if name not in vectors:
            places.append((name, None))
        elif first is not None and len(first) and (row := first[name][0].as_py()):
            places += [(name, k) for k in range(min(len(row), LONGEST))]
    return places


def _is_vector(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
