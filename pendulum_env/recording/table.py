"""Raw table of a file, as the reader of each format returns it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from typing import Protocol

import numpy as np
import pyarrow as pa

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.notes import Note

WIDEST = 64  # elements of a vector that become columns of their own, and columns that a person is shown
TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}  # of a time stamp of Arrow in a second


class ColumnFinder(Protocol):
    """Choose the columns to read, by quantity."""

    def __call__(self, headers: Sequence[str], *, wordy: Collection[int] = ()) -> dict[str, FileColumn]:
        """Choose from all names; `wordy` are the places of columns that hold no numbers."""
        ...


@dataclass(frozen=True)
class RawTable:
    """Columns found in a file with their raw values: units as in the file, NaN for empty cells."""

    headers: Sequence[str]  # of all columns in it
    columns: dict[str, FileColumn]  # by quantity
    values: dict[str, Array]  # by quantity, each (N,)
    notes: tuple[Note, ...] = ()  # what else a user should know
    date: datetime | None = None  # of the first row, if time is a date


def convert_numbers(column: pa.ChunkedArray) -> Array:
    """Convert an Arrow column to numbers (N,): null to NaN, `true` to 1, dates to seconds, words to indices."""
    if pa.types.is_timestamp(column.type):
        import pyarrow.compute as pc  # takes a while to import, as does every cast

        ticks = float(TICKS[column.type.unit])
        column = pc.divide(pc.subtract(column.cast(pa.int64()), pc.min(column).value).cast(pa.float64()), ticks)
    if pa.types.is_duration(column.type):
        column = pa.chunked_array(
            [np.array(column.cast(pa.int64()).cast(pa.float64(), safe=False)) / TICKS[column.type.unit]]
        )
    if is_text(column.type):
        whole = column.combine_chunks()
        encoded = whole if pa.types.is_dictionary(whole.type) else whole.dictionary_encode()
        column = pa.chunked_array([encoded.indices])
    if column.type != pa.float64():
        column = column.cast(pa.float64(), safe=False)
    return np.concatenate([np.empty(0), *map(_copy_floats, column.chunks)])


def _copy_floats(chunk: pa.DoubleArray) -> Array:
    """Copy a chunk of floats (N,), null as NaN, from its buffers: a conversion by Arrow imports pandas."""
    if not len(chunk):
        return np.empty(0)
    (is_valid, values), own = chunk.buffers(), slice(chunk.offset, chunk.offset + len(chunk))
    copied = np.frombuffer(values, np.float64)[own].copy()
    if is_valid is not None:
        bits = np.unpackbits(np.frombuffer(is_valid, np.uint8), bitorder="little")[own]
        copied[bits == 0] = np.nan
    return copied


def is_text(kind: pa.DataType) -> bool:
    """Return whether an Arrow column holds words, plain or dictionary-encoded."""
    own = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(own) or pa.types.is_large_string(own) or pa.types.is_string_view(own))


def find_first_date(column: pa.ChunkedArray) -> datetime | None:
    """Return the date of the first time stamp, UTC without a zone; None for other columns."""
    if not pa.types.is_timestamp(column.type):
        return None
    import pyarrow.compute as pc  # takes a while to import

    first = pc.min(column.cast(pa.int64())).as_py()
    return None if first is None else datetime.fromtimestamp(first / TICKS[column.type.unit], UTC)


def require_module(module: str) -> None:
    """Refuse a file whose library is not installed."""
    if find_spec(module) is None:
        raise RecordingError("it needs the extra formats: pip install 'pendulum-ident[formats]', or export it as CSV")
