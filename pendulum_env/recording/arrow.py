"""Read Parquet, and tables in memory by Arrow: data frames of pandas and Polars, and tables of pyarrow."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
from numpy.typing import NDArray

from pendulum_env.errors import RecordingError
from pendulum_env.recording.arrays import Series, build_table, read_arrays
from pendulum_env.recording.table import ColumnFinder, RawTable, convert_series
from pendulum_env.recording.vocabulary import INDICES


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
