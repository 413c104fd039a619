"""What every file format is read into, before anyone asks whether it makes sense."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pendulum_env._typing import Array
from pendulum_env.reading import refuse_size
from pendulum_env.recording.columns import Column
from pendulum_env.recording.record import RecordingError

LARGEST = 500_000_000  # bytes that a recording may take, unpacked, as text or in memory: some 8 million rows of CSV
REMEDY = "shorten it, or allow more by --max-size (largest=)"  # on the command line and in Python
Find = Callable[[Sequence[str]], dict[str, Column]]  # which of the columns with these names are read, by quantity


@dataclass(frozen=True)
class Table:
    """The columns found in a file and their values as they stand there: units as in the file, NaN for empty cells."""

    columns: dict[str, Column]  # by quantity
    values: dict[str, Array]  # by quantity, each (N,)
    notes: tuple[str, ...] = ()  # what else a user should know


def gather(columns: dict[str, Column], blocks: Iterable[list[Array]], largest: float = LARGEST) -> Table:
    """Join blocks of rows, each a list in the order of `columns`, holding the result once and one block beside it.

    Raises:
        Unreadable: if the rows take more than `largest` bytes.
    """
    values = {quantity: np.empty(0) for quantity in columns}
    rows = room = 0
    for block in blocks:
        start, rows = rows, rows + len(block[0])
        refuse_size(8 * rows * len(columns), largest, REMEDY)
        if rows > room:
            room = max(rows, room * 5 // 4)
            _resize(values, room)
        for column, piece in zip(values.values(), block, strict=True):
            column[start:rows] = piece
    _resize(values, rows)
    return Table(columns, values)


def _resize(values: dict[str, Array], rows: int) -> None:
    for column in values.values():
        column.resize(rows, refcheck=False)  # in place: large arrays are remapped, not copied


def since(stamps: pa.Array, began: int) -> pa.Array:
    """Time stamps as seconds since `began`, in the unit of the stamps since 1970."""
    ticks = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[stamps.type.unit]
    return pc.divide(pc.subtract(stamps.cast(pa.int64()), began).cast(pa.float64()), ticks)


def need(module: str) -> None:
    """Refuse a file whose library is not installed.

    Raises:
        RecordingError: with the command that installs it.
    """
    if find_spec(module) is None:
        raise RecordingError("it needs the extra formats: pip install 'pendulum-ident[formats]', or export it as CSV")


def one_line(error: Exception) -> str:
    """The text of a library's error, fit for the middle of a sentence."""
    return " ".join(str(error).split())[:200].rstrip(".:") or type(error).__name__
