"""What every file format is read into, before anyone asks whether it makes sense."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.recording.columns import Column

Named = Mapping[str, str] | None  # columns that the user names, by quantity


@dataclass(frozen=True)
class Table:
    """The columns found in a file and their values as they stand there: units as in the file, NaN for empty cells."""

    columns: dict[str, Column]  # by quantity
    values: dict[str, Array]  # by quantity, each (N,)


def gather(columns: dict[str, Column], blocks: Iterable[list[Array]]) -> Table:
    """Join blocks of rows, each a list in the order of `columns`, holding the result once and one block beside it."""
    values = {quantity: np.empty(0) for quantity in columns}
    rows = room = 0
    for block in blocks:
        start, rows = rows, rows + len(block[0])
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


def one_line(error: Exception) -> str:
    """The text of a library's error, fit for the middle of a sentence."""
    return " ".join(str(error).split())[:200].rstrip(".:") or type(error).__name__
