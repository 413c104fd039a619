"""What every file format is read into, before anyone asks whether it makes sense."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import pyarrow as pa

from pendulum_env._typing import Array
from pendulum_env.recording.columns import Column
from pendulum_env.recording.record import RecordingError

WIDEST = 64  # elements of a vector that become columns of their own, and columns that a person is shown
Find = Callable[[Sequence[str]], dict[str, Column]]  # which of the columns with these names are read, by quantity


@dataclass(frozen=True)
class Table:
    """The columns found in a file and their values as they stand there: units as in the file, NaN for empty cells."""

    headers: Sequence[str]  # of all columns in it
    columns: dict[str, Column]  # by quantity
    values: dict[str, Array]  # by quantity, each (N,)
    notes: tuple[str, ...] = ()  # what else a user should know


def numbers(column: pa.ChunkedArray) -> Array:
    """Values (N,) of a column of Arrow, nulls as NaN; time stamps in seconds since the first."""
    if pa.types.is_timestamp(column.type):
        import pyarrow.compute as pc  # takes a while to import, as does every cast

        ticks = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[column.type.unit]
        column = pc.divide(pc.subtract(column.cast(pa.int64()), pc.min(column).value).cast(pa.float64()), ticks)
    if column.type != pa.float64():
        column = column.cast(pa.float64(), safe=False)
    return np.array(column.to_numpy())


def need(module: str) -> None:
    """Refuse a file whose library is not installed.

    Raises:
        RecordingError: with the command that installs it.
    """
    if find_spec(module) is None:
        raise RecordingError("it needs the extra formats: pip install 'pendulum-ident[formats]', or export it as CSV")
