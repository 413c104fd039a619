"""Preview of a file: names of its columns and their raw values."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.recording.columns import FileColumn, guess_columns, parse_column
from pendulum_env.recording.formats import Readable, get_label, read_table
from pendulum_env.recording.table import WIDEST


@dataclass(frozen=True, eq=False)
class Preview:
    """The columns of a file.

    Attributes:
        headers: their names.
        values: of each as they stand in the file (N,), NaN where a cell is empty; None of a column without numbers.
    """

    headers: tuple[str, ...]
    values: tuple[Array | None, ...]

    @cached_property
    def guessed(self) -> dict[str, str]:
        """Name of the likely column by quantity."""
        return guess_columns([name for name, x in zip(self.headers, self.values, strict=True) if x is not None])

    def read_seconds(self, time: str) -> Array | None:
        """Return time (N,) [s] from the first row on by an expression of a column; None if it is no time.

        This is what the range of a source counts: rows without a time are NaN.
        """
        try:
            column = parse_column("time", time, self.headers)
        except RecordingError:
            return None
        values = self.values[column.index]
        finite = np.array([]) if values is None else values[np.isfinite(values)]
        return column.scale * (values - finite[0]) if values is not None and len(finite) else None


def read_preview(source: Readable, most: int = WIDEST) -> Preview:
    """Read the first columns of a file or table as `read_recording` reads those in need."""
    try:
        return _look(source, most)
    except RecordingError as error:
        raise RecordingError(f"{get_label(source)}: {error}") from error.__cause__


def _look(source: Readable, most: int) -> Preview:
    headers: list[str] = []

    def some(places: slice, names: Sequence[str], **_: object) -> dict[str, FileColumn]:
        headers[:] = [name.strip() for name in names[:most]]
        # readers take dates in place of time, and messages at the times of those with the position
        quantities = ("time", "position", *map(str, range(most)))
        chosen = list(enumerate(headers))[places]
        return {q: FileColumn(q, name, k, None) for q, (k, name) in zip(quantities, chosen, strict=False)}

    def alone(k: int) -> Array | None:
        try:
            values = read_table(source, partial(some, slice(k, k + 1))).values["time"]
        except RecordingError:  # no numbers
            return None
        return values if len(values) > 1 else None

    try:
        values: list[Array | None] = list(read_table(source, partial(some, slice(None))).values.values())
    except RecordingError:
        if not headers:
            raise
        values = [alone(k) for k in range(len(headers))]
    return Preview(tuple(headers), tuple(None if x is None or not len(x) else x for x in values))
