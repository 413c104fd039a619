"""Raw table of a file, the result of the reader of each format."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from typing import Protocol

import numpy as np
import pyarrow as pa

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.recording.columns import Column
from pendulum_env.recording.notes import Note

WIDEST = 64  # elements of a vector that become columns of their own, and columns that a person is shown
TICKS = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}  # of a time stamp of Arrow in a second


class Find(Protocol):
    """Choose the columns to read, by quantity."""

    def __call__(self, headers: Sequence[str], *, wordy: Collection[int] = ()) -> dict[str, Column]:
        """Choose from all names; `wordy` are the places of columns that hold no numbers."""
        ...


@dataclass(frozen=True)
class Table:
    """The columns found in a file and their values as they stand there: units as in the file, NaN for empty cells."""

    headers: Sequence[str]  # of all columns in it
    columns: dict[str, Column]  # by quantity
    values: dict[str, Array]  # by quantity, each (N,)
    notes: tuple[Note, ...] = ()  # what else a user should know
    date: datetime | None = None  # of the first row, if time is a date


def numbers(column: pa.ChunkedArray) -> Array:
    """Values (N,) of a column of Arrow, nulls as NaN: `true` is 1, time in seconds since the first, words by number."""
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
    return np.array(column.to_numpy())


def is_text(kind: pa.DataType) -> bool:
    """Return whether a column of Arrow holds words, each in its place or by number."""
    own = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(own) or pa.types.is_large_string(own) or pa.types.is_string_view(own))


def first_date(column: pa.ChunkedArray) -> datetime | None:
    """Date of the first of a column of time stamps, of UTC where no zone is given; None of other columns."""
    if not pa.types.is_timestamp(column.type):
        return None
    import pyarrow.compute as pc  # takes a while to import

    first = pc.min(column.cast(pa.int64())).as_py()
    return None if first is None else datetime.fromtimestamp(first / TICKS[column.type.unit], UTC)


def need(module: str) -> None:
    """Refuse a file whose library is not installed.

    Raises:
        RecordingError: with the command that installs it.
    """
    if find_spec(module) is None:
        raise RecordingError("it needs the extra formats: pip install 'pendulum-ident[formats]', or export it as CSV")
