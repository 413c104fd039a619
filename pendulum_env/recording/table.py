"""Raw table of a file, the result of each reader."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.notes import Note

WIDEST = 64  # most elements of a vector that are read as columns, and most columns of a preview


class ColumnFinder(Protocol):
    """Function that chooses the columns to read, by quantity."""

    def __call__(
        self, headers: Sequence[str], *, text_columns: Collection[int] = (), date_columns: Collection[int] = ()
    ) -> dict[str, FileColumn]:
        """Choose from all names, and the places of columns without numbers and of those with dates."""
        ...


@dataclass(frozen=True)
class RawTable:
    """Columns of a file with raw values, in the units of the file, with NaN for empty cells."""

    columns: dict[str, FileColumn]  # by quantity
    values: dict[str, Array]  # by quantity, each (N,)
    notes: tuple[Note, ...] = ()  # notes of the reader
    date: datetime | None = None  # date of the first row


def convert_series(column: pa.ChunkedArray | pa.Array) -> NDArray[Any]:
    """Convert an Arrow column to an array (N,): floats with NaN for null, dates, durations, or texts with None.

    Vectors become rows (N, K) of at most `WIDEST` elements, and other types void elements (N,).
    """
    kind, types = column.type, pa.types
    if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
        import pyarrow.compute as pc  # slow import

        elements = range(min(len(column[0].as_py() or ()), WIDEST))
        series = [convert_series(pc.list_element(column, k)) for k in elements]
        return np.stack(series, axis=1) if series else np.empty((len(column), 0))
    value_type = kind.value_type if types.is_dictionary(kind) else kind
    if types.is_string(value_type) or types.is_large_string(value_type) or types.is_string_view(value_type):
        return np.array([*column.to_pylist(), None], dtype=object)[:-1]
    is_date, is_number = types.is_timestamp(kind), types.is_primitive(kind) or types.is_decimal(kind)
    if is_number and not types.is_temporal(kind):
        plain = column if kind == pa.float64() else column.cast(pa.float64(), safe=False)
        return _copy_values(plain, np.float64, np.nan)
    if is_date or types.is_duration(kind):
        ticks = _copy_values(column.cast(pa.int64()), np.int64, np.iinfo(np.int64).min)  # NaT
        return ticks.view(f"{'M' if is_date else 'm'}8[{kind.unit}]")
    return np.empty(len(column), dtype=np.void)


def _copy_values(column: pa.ChunkedArray | pa.Array, dtype: type[np.generic], null: float) -> NDArray[Any]:
    """Copy floats or integers of 64 bits (N,) from their buffers, as a conversion by Arrow imports pandas."""
    parts = [np.empty(0, dtype)]
    for chunk in column.chunks if isinstance(column, pa.ChunkedArray) else [column]:
        (is_valid, values), rows = chunk.buffers(), slice(chunk.offset, chunk.offset + len(chunk))
        part = np.frombuffer(values or b"", dtype)[rows].copy()
        if is_valid is not None:
            part[np.unpackbits(np.frombuffer(is_valid, np.uint8), bitorder="little")[rows] == 0] = null
        parts.append(part)
    return np.concatenate(parts)


def rank_words(cells: NDArray[Any]) -> Array:
    """Return the alphabetical ranks of words (N,)."""
    return np.unique(cells.astype(str), return_inverse=True)[1].astype(np.float64)


def require_module(module: str) -> None:
    """Refuse a file whose library is not installed."""
    if find_spec(module) is None:
        raise RecordingError("it needs the extra formats: pip install 'pendulum-ident[formats]', or export it as CSV")
