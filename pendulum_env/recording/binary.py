"""Parquet and NPZ."""

import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pendulum_env._typing import Array
from pendulum_env.recording.columns import find_columns
from pendulum_env.recording.record import RecordingError
from pendulum_env.recording.table import Named, Table, gather


def read_parquet(path: Path, named: Named = None) -> Table:
    """The columns in need, read row group by row group, nulls as NaN.

    Raises:
        RecordingError: if a column is missing or does not hold numbers.
    """
    with pq.ParquetFile(path, pre_buffer=False) as file:
        schema = file.schema_arrow
        columns = find_columns(schema.names, named)
        for quantity, column in columns.items():
            kind = schema.field(column.index).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
                raise RecordingError(
                    f"column {column.header!r} ({quantity}) has type {kind}: store it as a floating-point number in SI"
                )
        return gather(columns, _row_groups(file, [schema.names[column.index] for column in columns.values()]))


def _row_groups(file: pq.ParquetFile, names: list[str]) -> Iterator[list[Array]]:
    for batch in file.iter_batches(columns=names, use_threads=False):
        yield [batch[name].cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False) for name in names]


def read_npz(path: Path, named: Named = None) -> Table:
    """The arrays in need, never unpickled.

    Raises:
        RecordingError: if an array is missing, does not hold real numbers, is not one-dimensional, or if the lengths
            differ.
    """
    if not zipfile.is_zipfile(path):
        raise RecordingError("it is no NPZ archive, or a damaged one: write it with numpy.savez")
    with np.load(path, allow_pickle=False) as archive:
        columns = find_columns(archive.files, named)
        arrays = {quantity: archive[column.header] for quantity, column in columns.items()}
    for quantity, array in arrays.items():
        if array.dtype.kind not in "iuf" or array.ndim != 1:
            raise RecordingError(
                f"array {columns[quantity].header!r} ({quantity}) has type {array.dtype} and shape {array.shape}: "
                "store real numbers with one dimension"
            )
    if len({len(array) for array in arrays.values()}) > 1:
        lengths = ", ".join(f"{quantity} {len(array)}" for quantity, array in arrays.items())
        raise RecordingError(f"the arrays differ in length ({lengths}): store one value of each per sample")
    return Table(columns, {quantity: np.array(array, dtype=np.float64) for quantity, array in arrays.items()})
