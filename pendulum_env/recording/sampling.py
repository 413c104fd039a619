"""Uniform time: told apart from rounding of what was printed, and made where samples were lost or the clock uneven."""

import numpy as np

from pendulum_env._typing import Array, Index
from pendulum_env.recording.record import RecordingError, is_uniform, unevenness
from pendulum_env.words import listing

LONG = 1.5  # steps of the median from which a sample seems to be lost; a single lost sample is bridged
EVEN = 0.1  # of a step: where all steps are as close to one, or to several, it is clear how many samples are lost
IN_A_ROW = 3  # lost samples that are filled in: at 200 Hz and 2 Hz of motion the spline errs by 1e-5 of the amplitude
MOST_LOST = 0.01  # of all samples
PLACES = 5  # where samples were lost, as many as a note names
GAP = 2.5  # steps of the median from which it is a gap, which nothing can bridge
NEGLIGIBLE = 1e-4  # of a step: at 1 kHz and 10 rad/s this moves position by 1e-6 rad
BLOCK = 1 << 18  # samples interpolated at a time
MARGIN = 32  # samples on either side of a block; a cubic spline forgets by 0.27 per sample


def refuse_bad_time(time: Array) -> None:
    """Raise unless time (N,) [s] increases without gaps.

    Raises:
        RecordingError: with the row, and what to do about it.
    """
    steps = np.diff(time)
    if steps.min() <= 0:
        first = int(np.argmax(steps <= 0))
        where = f"time does not increase at data row {first + 2} (header not counted)"
        if steps[first] == 0:
            raise RecordingError(
                f"{where} but repeats {time[first]:.9g} s: remove repeated rows, or write time with more decimals"
            )
        raise RecordingError(
            f"{where} but falls from {time[first]:.9g} to {time[first + 1]:.9g} s: sort the rows, or split the file"
        )
    row, longest = int(np.argmax(steps)) + 2, float(steps.max())
    usual = float(np.median(steps, overwrite_input=True))
    if longest > GAP * usual and not lost(time).any():  # rounding alone never more than doubles a step
        raise RecordingError(
            f"a gap of {longest:.3g} s ends at data row {row} (header not counted), with {usual:.3g} s between samples "
            "elsewhere: split the file there"
        )


def skips(time: Array, position: Array) -> bool:
    """Whether position (N,) moves on in the long steps of time (N,) [s] as in several: samples were lost there.

    A clock whose period is no multiple of the printed digits has long steps, too, but the joint does not know of them.
    """
    steps, moves = np.diff(time), np.diff(position)
    long = np.flatnonzero(steps[1:-1] > LONG * float(np.median(steps))) + 1
    beside = 0.5 * (moves[long - 1] + moves[long + 1])
    return bool(moves[long] @ beside > LONG * (beside @ beside))


def lost(time: Array, position: Array | None = None) -> Index:
    """How many samples are lost between each and the next of time (N,) [s], (N - 1,): zeros unless clearly a few are.

    Long steps at regular intervals may be rounding of a slower clock: then position (N,) tells, where it is given.
    """
    steps = np.diff(time)
    none = np.zeros(len(steps), dtype=np.intp)
    usual = float(np.median(steps))
    if steps.max() <= LONG * usual:
        return none
    counts = np.round(steps / usual).astype(np.intp)
    missing, places = counts - 1, np.flatnonzero(counts != 1)
    even = counts.min() == 1 and np.abs(steps / usual - counts).max() <= EVEN
    if not even or missing.max() > IN_A_ROW or missing.sum() > MOST_LOST * len(time):
        return none
    if len(places) > 2 and np.ptp(np.diff(places)) <= 1 and printed_resolution(time) > usual / 2:
        return missing if position is not None and skips(time, position) else none
    return missing


def filled(values: dict[str, Array]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The same signals, by quantity, with the few samples that were lost filled in, and notes that say where.

    Position and velocity are interpolated by cubic splines, torque linearly: nobody knows what it was.
    """
    time = values["time"]
    missing = lost(time, values["position"])
    if not missing.any():
        return values, ()
    known = np.append(0, np.cumsum(missing + 1))  # (N,), places of the samples that there are
    every = np.arange(known[-1] + 1)
    full = {name: np.interp(every, known, values[name]) for name in ("time", "torque")}
    for name in values.keys() - full.keys():
        full[name] = _interpolated(full["time"], time, values[name])
        full[name][known] = values[name]
    rows = [str(row) for row in np.flatnonzero(missing) + 1]
    listed = [*rows[:PLACES], *([f"{len(rows) - PLACES} more"] if len(rows) > PLACES else [])]
    count = int(missing.sum())
    many = f"{count} samples are" if count > 1 else "1 sample is"
    note = f"{many} missing after data row{'s' if len(rows) > 1 else ''} {listing(listed)}: filled in by interpolation"
    return {name: full[name] for name in values}, (note,)


def printed_resolution(time: Array) -> float:
    """Last decimal place [s] that time was rounded to, or float32's; 0 if neither explains the digits."""
    tail = time[-1000:]  # where time is largest and rounding coarsest
    size = np.abs(tail).max()
    single = float(np.spacing(np.float32(size))) if (tail == tail.astype(np.float32)).all() else 0.0
    for decimals in range(10):
        scaled = tail * 10.0**decimals
        if (np.abs(scaled - np.round(scaled)) <= 8 * np.spacing(size * 10.0**decimals)).all():
            return max(single, 10.0**-decimals)
    return single


def uniform(values: dict[str, Array]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The same signals, by quantity, on uniform time, and notes on what was done.

    The few samples that an even clock lost are filled in first. Time that is uniform then, or would be but for the
    rounding of its printed digits, leaves the signals as they are. Else position and velocity are interpolated by cubic
    splines, and torque, held from sample to sample, becomes its mean over each new step: the impulse it gives is kept,
    and jitter never shifts it by a whole sample.
    """
    values, notes = filled(values)
    time = values["time"]
    if is_uniform(time):
        return values, notes
    step = (time[-1] - time[0]) / (len(time) - 1)
    off = unevenness(time)
    if off <= max(1.001 * printed_resolution(time), NEGLIGIBLE * step) and not skips(time, values["position"]):
        grid = np.linspace(time[0], time[-1], len(time))
        note = f"time set to uniform {1 / step:.6g} Hz, from which it differed by rounding only (up to {off:.2g} s)"
        return values | {"time": grid}, (*notes, note)

    steps = np.diff(time)
    usual = float(np.median(steps))
    long = int(np.count_nonzero(steps > LONG * usual))
    count = round((time[-1] - time[0]) / usual) + 1 if long else len(time)
    grid = np.linspace(time[0], time[-1], count)
    resampled = {name: _interpolated(grid, time, values[name]) for name in values if name not in ("time", "torque")}
    resampled |= {"time": grid, "torque": _mean_held(grid, time, values["torque"])}
    note = (
        f"resampled to {(count - 1) / (grid[-1] - grid[0]):.6g} Hz: steps were {1e3 * steps.min():.4g} to "
        f"{1e3 * steps.max():.4g} ms (standard deviation {1e3 * steps.std():.2g} ms)"
    )
    return resampled, (*notes, f"{note}, {long} of them over {LONG:g} times the usual" if long else note)


def _mean_held(grid: Array, time: Array, torque: Array) -> Array:
    """Mean over each step of grid (M,) of torque (N,) held from one time (N,) to the next; same unit."""
    impulse = np.interp(grid, time, np.append(0.0, np.cumsum(torque[:-1] * np.diff(time))))  # [N m s]
    return np.append(np.diff(impulse) / np.diff(grid), torque[-1])


def _interpolated(grid: Array, time: Array, values: Array) -> Array:
    """Cubic spline through values (N,) at time (N,), read at grid (M,), block by block to bound memory."""
    from scipy.interpolate import CubicSpline  # here, as it takes half a second

    result = np.empty_like(grid)
    for start in range(0, len(grid), BLOCK):
        block = grid[start : start + BLOCK]
        first, last = np.searchsorted(time, block[[0, -1]])
        near = slice(max(first - MARGIN, 0), last + MARGIN)
        result[start : start + BLOCK] = CubicSpline(time[near], values[near])(block)
    return result
