"""Dates and times of day in texts."""

import re
from datetime import UTC, datetime

import numpy as np
import pyarrow as pa

from pendulum_env.recording.table import convert_series

CLOCK = re.compile(r"\s*(?:\d+:)?\d{1,2}:\d{1,2}(?:[.,]\d+)?\s*")  # hours, minutes and seconds
DAY = 86400.0  # [s]
STAMP = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:[.,]\d{1,9})?)?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*")


def convert_times(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Convert times of day to seconds, continued after midnight; dates with a decimal comma to dates."""
    import pyarrow.compute as pc  # takes a while to import

    column = pc.replace_substring(column, ",", ".")
    if not CLOCK.fullmatch(column[0].as_py() or ""):
        return column.cast(pa.timestamp("ns"))
    parts = pc.split_pattern(column, ":")
    count = len(parts[0])
    seconds = sum(
        60.0 ** (count - 1 - k) * convert_series(pc.list_element(parts, k).cast(pa.float64())) for k in range(count)
    )
    if count == 3:
        seconds = seconds + np.append(0.0, np.cumsum(np.where(np.diff(seconds) < -DAY / 2, DAY, 0.0)))
    return pa.chunked_array([seconds])


def parse_date(stamp: str) -> datetime:
    """Parse a date, UTC without a zone; digits below a microsecond are dropped."""
    date = datetime.fromisoformat(re.sub(r"(\.\d{6})\d+", r"\1", stamp.strip().replace(",", ".")))
    return date if date.tzinfo else date.replace(tzinfo=UTC)
