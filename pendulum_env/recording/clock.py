"""Convert and check the time of a log: Unix time, dates, overflows, rounding and uniformity."""

import re
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.recording.vocabulary import UNITS

TIME_UNITS = ("s", "ms", "us", "ns")
EPOCH = (datetime(1990, 1, 1, tzinfo=UTC).timestamp(), datetime(2100, 1, 1, tzinfo=UTC).timestamp())  # [s] since 1970
EXACT, LOOSE = 1e-6, 1e-5  # largest deviation from uniform time, as share of a step, of files and of their slices
STEPS = (1e-5, 0.1)  # [s], least and largest plausible sample time


TIME_OF_DAY = r"(?:\d+:)?\d{1,2}:\d{1,2}(?:[.,]\d{1,9})?"
DAY_FIRST = r"\d{1,2}[-./]\d{1,2}[-./]\d{4},?\s+"  # or the month first: the time of day alone is used
STAMP = re.compile(rf"\s*\d{{4}}[-./]\d\d[-./]\d\d[T ]{TIME_OF_DAY}\s*(?P<zone>Z|[+-]\d\d:?\d\d)?\s*")
CLOCK = re.compile(rf"\s*(?:{DAY_FIRST})?{TIME_OF_DAY}\s*(?:[AP]M)?\s*", re.IGNORECASE)


def is_stamp(cell: str) -> bool:
    """Test whether a cell holds a date with the time of day, or the time of day alone."""
    return bool(STAMP.fullmatch(cell) or CLOCK.fullmatch(cell))


def find_date(start: float) -> datetime | None:
    """Convert a time in seconds since 1970 to a date; return None for implausible years."""
    return datetime.fromtimestamp(start, UTC) if EPOCH[0] <= start < EPOCH[1] else None


def parse_date(stamp: str) -> datetime:
    """Parse a date, UTC without a zone; digits below a microsecond are dropped."""
    date = datetime.fromisoformat(re.sub(r"(\d)[./](\d\d)[./](\d\d)", r"\1-\2-\3", stamp.strip()))
    return date if date.tzinfo else date.replace(tzinfo=UTC)


def count_seconds(time: NDArray[Any]) -> tuple[Array, datetime | None]:
    """Convert dates (N,) to seconds from the first, returned too, or durations to seconds; NaT becomes NaN."""
    if time.dtype.kind != "M":
        return time / np.timedelta64(1, "s"), None
    dates = time[~np.isnat(time)]
    if not len(dates):
        return np.full(time.shape, np.nan), None
    date = datetime.fromtimestamp(dates[0].astype("datetime64[us]").astype(np.int64) / 1e6, UTC)
    return (time - dates[0]) / np.timedelta64(1, "s"), date


def find_unix_unit(time: Array) -> str | None:
    """Find the unit of Unix time (N,) by its date and its steps; return None for other clocks."""
    finite = time[np.isfinite(time)]
    if len(finite) < 2:
        return None
    step = float(np.median(np.abs(np.diff(finite))) or np.ptp(finite) / (len(finite) - 1))  # 0 if rows repeat a time
    units = list_plausible_units(step)
    return next((unit for unit in units if find_date(finite[0] * UNITS["time"][unit]) is not None), None)


def unwrap_clock(time: Array) -> Array:
    """Undo the overflows of a clock (N,) of 16 or 32 bits, in its counts."""
    steps = np.diff(time)
    is_back = steps < 0
    if not 0 < np.count_nonzero(is_back) < 0.1 * len(steps):
        return time
    for bits in (16, 32):
        forward = steps[is_back] + 2.0**bits
        if ((forward > 0) & (forward < 10 * np.median(steps[~is_back]))).all():
            return time + np.append(0.0, np.cumsum(np.where(is_back, 2.0**bits, 0.0)))
    return time


def list_plausible_units(step: float) -> list[str]:
    """List the units in which a step of the file's time is a plausible sample time."""
    return [unit for unit in TIME_UNITS if STEPS[0] <= step * UNITS["time"][unit] <= STEPS[1]]


def find_resolution(time: Array) -> float:
    """Return the decimal place to which time was rounded, or the spacing of float32 [s]; 0 if neither fits."""
    tail = time[-1000:]  # largest rounding
    size = np.abs(tail).max()
    single = float(np.spacing(np.float32(size))) if (tail == tail.astype(np.float32)).all() else 0.0
    for decimals in range(10):
        scaled = tail * 10.0**decimals
        if (np.abs(scaled - np.round(scaled)) <= 8 * np.spacing(size * 10.0**decimals)).all():
            return max(single, 10.0**-decimals)
    return single


def is_uniform(time: Array, starts: tuple[int, ...] = (0,), tolerance: float = EXACT) -> bool:
    """Return whether time (N,) [s] increases and is uniform within segments, with one period.

    Deviations up to `tolerance` of a step plus the rounding of float64 are allowed. Segments have at least two samples.
    """
    bounds = (*starts, len(time))
    step = sum_durations(time, starts) / (len(time) - len(starts))
    allowed = tolerance * step + 4 * np.spacing(np.abs(time[[0, -1]]).max())
    return bool(
        step > 0
        and all(time[start] > time[start - 1] for start in starts[1:])
        and all(compute_unevenness(time[a:b], step) <= allowed for a, b in pairwise(bounds))
    )


def count_from_zero(time: Array, starts: tuple[int, ...] = (0,)) -> Array:
    """Return time (N,) [s] from 0 on a uniform grid per segment, which removes the rounding of float64."""
    step = sum_durations(time, starts) / (len(time) - len(starts))
    bounds = pairwise((*starts, len(time)))
    return np.concatenate([time[a] - time[0] + step * np.arange(b - a, dtype=np.float64) for a, b in bounds])


def compute_unevenness(time: Array, step: float | None = None) -> float:
    """Return the largest deviation [s] of time (N,) from a uniform grid with its ends, or its start and `step`."""
    last = time[-1] if step is None else time[0] + (len(time) - 1) * step
    distance = np.linspace(time[0], last, len(time))
    distance -= time  # in place: recordings may be large
    return float(np.abs(distance, out=distance).max())


def sum_durations(time: Array, starts: tuple[int, ...] = (0,)) -> float:
    """Return the sum of the durations of all segments [s]."""
    return float(sum(time[b - 1] - time[a] for a, b in pairwise((*starts, len(time)))))
