"""Clock of a log: seconds since 1970 in any unit, the rounding of its digits, and time counted from 0."""

from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pendulum_env._typing import Array
from pendulum_env.recording.vocabulary import UNITS

TIME_UNITS = ("s", "ms", "us", "ns")
EPOCH = (datetime(1990, 1, 1, tzinfo=UTC).timestamp(), datetime(2100, 1, 1, tzinfo=UTC).timestamp())  # [s] since 1970
EXACT, LOOSE = 1e-6, 1e-5  # of a step that a clock may be off: a file's is left as it is, and so is any slice of it
STEPS = (1e-5, 0.1)  # [s] between samples of a recording, the least and the most


def find_date(start: float) -> datetime | None:
    """Convert a time in seconds since 1970 to a date; None if it cannot be since 1970."""
    return datetime.fromtimestamp(start, UTC) if EPOCH[0] <= start < EPOCH[1] else None


def parse_date(stamp: str) -> datetime:
    """Parse a date, UTC without a zone; digits below a microsecond are dropped."""
    date = datetime.fromisoformat(stamp.strip())
    return date if date.tzinfo else date.replace(tzinfo=UTC)


def count_seconds(time: NDArray[Any]) -> tuple[Array, datetime | None]:
    """Count dates (N,) in seconds from the first, which is returned too, or durations in seconds; NaT becomes NaN."""
    if time.dtype.kind != "M":
        return time / np.timedelta64(1, "s"), None
    known = time[~np.isnat(time)]
    if not len(known):
        return np.full(time.shape, np.nan), None
    date = datetime.fromtimestamp(known[0].astype("datetime64[us]").astype(np.int64) / 1e6, UTC)
    return (time - known[0]) / np.timedelta64(1, "s"), date


def find_unix_unit(time: Array) -> str | None:
    """Find the unit of a clock (N,) that counts since 1970, by its date and its steps; None if it does not."""
    known = time[np.isfinite(time)]
    if len(known) < 2:
        return None
    units = list_plausible_units(float(np.median(np.abs(np.diff(known)))))
    return next((unit for unit in units if find_date(known[0] * UNITS["time"][unit]) is not None), None)


def unwrap_clock(time: Array) -> Array:
    """Unwrap a clock (N,) of 16 or 32 bits, in its own counts, where it overflows."""
    steps = np.diff(time)
    back = steps < 0
    if not 0 < np.count_nonzero(back) < 0.1 * len(steps):
        return time
    for bits in (16, 32):
        forward = steps[back] + 2.0**bits
        if ((forward > 0) & (forward < 10 * np.median(steps[~back]))).all():
            return time + np.append(0.0, np.cumsum(np.where(back, 2.0**bits, 0.0)))
    return time


def list_plausible_units(step: float) -> list[str]:
    """List the units in which a step of time, as the file has it, is that of a recording."""
    return [unit for unit in TIME_UNITS if STEPS[0] <= step * UNITS["time"][unit] <= STEPS[1]]


def find_resolution(time: Array) -> float:
    """Find the last decimal place [s] that time was rounded to, or float32's; 0 if neither explains the digits."""
    tail = time[-1000:]  # where time is largest and rounding coarsest
    size = np.abs(tail).max()
    single = float(np.spacing(np.float32(size))) if (tail == tail.astype(np.float32)).all() else 0.0
    for decimals in range(10):
        scaled = tail * 10.0**decimals
        if (np.abs(scaled - np.round(scaled)) <= 8 * np.spacing(size * 10.0**decimals)).all():
            return max(single, 10.0**-decimals)
    return single


def is_uniform(time: Array, starts: tuple[int, ...] = (0,), tolerance: float = EXACT) -> bool:
    """Test whether time (N,) [s] increases, from each start on a uniform grid, all of one period.

    Up to `tolerance` of a step and the rounding of float64. Segments hold two samples or more.
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
    """Count time (N,) [s] from 0, each segment on a grid of one period, so that float64 no longer rounds its steps."""
    step = sum_durations(time, starts) / (len(time) - len(starts))
    bounds = pairwise((*starts, len(time)))
    return np.concatenate([time[a] - time[0] + step * np.arange(b - a, dtype=np.float64) for a, b in bounds])


def compute_unevenness(time: Array, step: float | None = None) -> float:
    """Return the largest distance [s] of time (N,) from the uniform grid with its ends, or with its start and step."""
    last = time[-1] if step is None else time[0] + (len(time) - 1) * step
    distance = np.linspace(time[0], last, len(time))
    distance -= time  # in place: recordings may be large
    return float(np.abs(distance, out=distance).max())


def sum_durations(time: Array, starts: tuple[int, ...] = (0,)) -> float:
    """Sum the time [s] from the first to the last sample of each segment."""
    return float(sum(time[b - 1] - time[a] for a, b in pairwise((*starts, len(time)))))
