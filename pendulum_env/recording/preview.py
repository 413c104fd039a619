"""Preview of a file: column names and raw values."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from pendulum_env._typing import Array
from pendulum_env.errors import RecordingError
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.formats import Readable, get_label, read_table
from pendulum_env.recording.table import WIDEST


@dataclass(frozen=True, eq=False)
class Preview:
    """First columns of a file.

    Attributes:
        headers: names of the columns.
        values: raw values of each column (N,), NaN for empty cells; None for a column without numbers.
    """

    headers: tuple[str, ...]
    values: tuple[Array | None, ...]


def read_preview(source: Readable, max_columns: int = WIDEST) -> Preview:
    """Read the first `max_columns` columns of a file or table."""
    headers: list[str] = []

    def select_columns(places: slice, names: Sequence[str], **_: object) -> dict[str, FileColumn]:
        headers[:] = [name.strip() for name in names[:max_columns]]
        # readers convert dates of time, and align messages to those of position
        quantities = ("time", "position", *map(str, range(max_columns)))
        chosen = list(enumerate(headers))[places]
        return {q: FileColumn(q, name, k, None) for q, (k, name) in zip(quantities, chosen, strict=False)}

    def read_column(k: int) -> Array | None:
        try:
            values = read_table(source, partial(select_columns, slice(k, k + 1))).values["time"]
        except RecordingError:  # no numbers
            return None
        return values if len(values) > 1 else None

    try:
        values: list[Array | None] = list(read_table(source, partial(select_columns, slice(None))).values.values())
    except RecordingError as error:
        if not headers:
            raise RecordingError(f"{get_label(source)}: {error}") from error.__cause__
        values = [read_column(k) for k in range(len(headers))]
    return Preview(tuple(headers), tuple(None if x is None or not len(x) else x for x in values))
