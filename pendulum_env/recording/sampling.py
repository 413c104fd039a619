"""Uniform time: where samples were lost, gaps that end a segment, and a clock that was rounded or uneven.

A hole is bridged where interpolation errs by less than the noise of the sensor, which is tried out on the recording
itself; at a longer gap the segment ends and another begins.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.errors import RecordingError
from pendulum_env.quantity import Quantity
from pendulum_env.recording.cleaning import Log
from pendulum_env.recording.clock import compute_unevenness, is_uniform
from pendulum_env.recording.notes import NAMED, Note, NoteKind


@dataclass(frozen=True)
class SamplingSettings:
    """Limits on gaps to bridge, on uneven steps, and on segments to keep."""

    long: float = 1.5  # steps of the median from which a sample seems to be lost
    whole: float = 0.25  # of a step: long steps as close to several are lost samples, others those of a slow clock
    in_a_row: int = 3  # lost samples that may be bridged: torque is unknown there
    above_noise: float = 2.0  # times the error that noise alone makes, up to which a hole is bridged
    fine: float = 1e-4  # of the range of position: an error as small is none, however quiet the sensor
    intact: int = 50_000  # samples on which bridging is tried out
    shortest: float = 0.2  # [s]; a shorter segment holds no window of an estimator
    fewest: int = 10  # samples of a segment
    negligible: float = 1e-4  # of a step: at 1 kHz and 10 rad/s this moves position by 1e-6 rad
    finer: int = 10  # times the samples that there are, at most, on uniform time
    small: int = 1_000_000  # samples that are always made


SAMPLING = SamplingSettings()
PIECES = 8  # of a period, by which torque is summed up


def cut_at_gaps(log: Log, position: Array) -> None:
    """Begin a segment after every gap of increasing time, beside those that begin where a column counts another run."""
    counted = log.values.get("segment")
    known = set() if counted is None else set((np.flatnonzero(np.diff(counted)) + 1).tolist())
    log.values = {quantity: column for quantity, column in log.values.items() if quantity != "segment"}
    time = log.values["time"]
    steps = np.diff(time)
    usual = float(np.median(steps))
    gaps = np.empty(0, dtype=np.intp)
    if steps.max() > SAMPLING.long * usual and not is_rounded(time, position, log.resolution):
        gaps = np.flatnonzero(steps > (count_bridgeable(time, position) + SAMPLING.long) * usual) + 1
    new = [int(gap) for gap in gaps if gap not in known]
    if new:
        sizes = steps[np.array(new) - 1]
        numbers = _make_seconds(shortest=sizes.min(), longest=sizes.max())
        log.notes.append(_note_times(NoteKind.GAPS, time[new] - sizes - time[0], len(new), numbers))
    log.starts = tuple(sorted({0, *known, *new}))


def drop_short_segments(log: Log) -> None:
    """Leave out segments too short for any estimate."""
    time = log.values["time"]
    parts = list(pairwise((*log.starts, len(time))))
    fits = [b - a >= SAMPLING.fewest and time[b - 1] - time[a] >= SAMPLING.shortest for a, b in parts]
    if not any(fits):
        which = "the recording does not last" if len(fits) == 1 else f"none of its {len(fits)} segments lasts"
        raise RecordingError(f"{which} {SAMPLING.shortest:g} s without a gap: record longer, without losing samples")
    short = [b - a for (a, b), fit in zip(parts, fits, strict=True) if not fit]
    if short:
        numbers = {"count": Quantity(len(short)), "samples": Quantity(sum(short))}
        log.notes.append(Note(NoteKind.SHORT_SEGMENTS, numbers=numbers | _make_seconds(least=SAMPLING.shortest)))
        lengths = [b - a for a, b in parts]
        log.keep_rows(np.repeat(fits, lengths))
        log.starts = _find_starts([length for length, fit in zip(lengths, fits, strict=True) if fit])


def _find_starts(lengths: Sequence[int]) -> tuple[int, ...]:
    """Return the first samples of consecutive segments with given lengths."""
    return tuple(np.cumsum([0, *lengths[:-1]]).tolist())


def is_rounded(time: Array, position: Array, resolution: float) -> bool:
    """Return whether long steps of time (N,) [s] come from rounding: regular, and unknown to the joint.

    Time was printed with that resolution [s].
    """
    steps = np.diff(time)
    usual = float(np.median(steps))
    places = np.flatnonzero(steps > SAMPLING.long * usual)
    regular = len(places) > 2 and np.ptp(np.diff(places)) <= 1
    return bool(regular and resolution > usual / 2 and not has_lost_samples(time, position))


def has_lost_samples(time: Array, position: Array) -> bool:
    """Return whether position (N,) changes in long time steps as in several samples.

    A clock whose period is no multiple of the printed digits has long steps, too, but the joint does not know of them.
    """
    steps, moves = np.diff(time), np.diff(position)
    long = np.flatnonzero(steps[1:-1] > SAMPLING.long * float(np.median(steps))) + 1
    beside = 0.5 * (moves[long - 1] + moves[long + 1])
    return bool(moves[long] @ beside > SAMPLING.long * (beside @ beside))


def count_bridgeable(time: Array, position: Array) -> int:
    """Return the largest number of adjacent lost samples that interpolation replaces within noise.

    For each number, that many samples are left out all over a stretch of position (N,) where none is lost, and the one
    in the middle is interpolated by the cubic through two samples on either side.
    """
    steps = np.diff(time)
    q = position[_find_longest_run(steps <= SAMPLING.long * float(np.median(steps)))]
    if len(q) < 20:
        return 0
    noise = float(np.std(np.diff(q, 6))) / np.sqrt(924.0)  # of white noise, the sum of squares of 1, -6, 15, ...
    for lost in range(1, SAMPLING.in_a_row + 1):
        nodes, middle = np.array([-1, 0, lost + 1, lost + 2]), (lost + 1) // 2
        weights = np.array([np.prod([(middle - b) / (a - b) for b in nodes if b != a]) for a in nodes])  # Lagrange
        span = len(q) - (lost + 3)
        guess = sum(w * q[1 + k : 1 + k + span] for w, k in zip(weights, nodes, strict=True))
        error = float(np.std(q[1 + middle : 1 + middle + span] - guess))
        allowed = SAMPLING.above_noise * noise * np.sqrt(1 + weights @ weights)
        if error > max(allowed, SAMPLING.fine * float(np.ptp(q))):
            return lost - 1
    return SAMPLING.in_a_row


def _find_longest_run(good: Mask) -> slice:
    """Return the samples of the longest run of good steps (N - 1,), `SAMPLING.intact` at most."""
    edges = np.flatnonzero(np.diff(good, prepend=False, append=False))
    first, end = edges[::2], edges[1::2]
    if not len(first):
        return slice(0, 0)
    longest = int(np.argmax(end - first))
    return slice(int(first[longest]), int(min(end[longest] + 1, first[longest] + SAMPLING.intact)))


def resample_uniformly(log: Log) -> None:
    """Resample the signals to uniform time of one period in all segments.

    The few samples that were lost are filled in first. Time that is uniform, apart from the rounding of its printed
    digits, leaves the signals as they are. Else position and velocity are interpolated by cubic splines,
    and torque, held from sample to sample, becomes its mean over each new step: the impulse it gives is kept, and
    jitter never shifts it by a whole sample.
    """
    time = log.values["time"]
    if is_uniform(time, log.starts):
        return
    parts = [{name: column[a:b] for name, column in log.values.items()} for a, b in pairwise((*log.starts, len(time)))]
    usual = float(np.median(np.concatenate([np.diff(part["time"]) for part in parts])))
    if len(parts) > 1 or not is_rounded(time, log.values["position"], log.resolution):
        parts = _fill_lost(log, parts, usual)
        _join(log, parts)
        time = log.values["time"]
    if is_uniform(time, log.starts):
        return
    steps = np.concatenate([np.diff(part["time"]) for part in parts])
    slow = steps > SAMPLING.long * usual
    period = float(np.mean(steps))
    off = max(compute_unevenness(part["time"], period) for part in parts)
    loses = len(parts) == 1 and has_lost_samples(time, log.values["position"])
    if off <= max(1.001 * log.resolution + log.rounding, SAMPLING.negligible * period) and not loses:
        grids = [_make_grid(part["time"][0], period, len(part["time"])) for part in parts]
        log.values = {**log.values, "time": np.concatenate(grids)}
        if off > log.rounding:
            rate = {"rate": Quantity(1 / period, unit="Hz")}
            log.notes.append(Note(NoteKind.CLOCK_ROUNDED, numbers=rate | _make_seconds(error=off)))
        return
    if slow.any():
        period = float(np.mean(steps[~slow]))
    _refuse_finer(sum(float(part["time"][-1] - part["time"][0]) for part in parts) / period, len(time), period)
    _join(log, [_resample_segment(part, period) for part in parts])
    numbers = {"rate": Quantity(1 / period, unit="Hz")}
    sizes = {"shortest": steps.min(), "longest": steps.max(), "std": steps.std()}
    numbers |= {name: Quantity(1e3 * float(size), unit="ms") for name, size in sizes.items()}
    numbers |= {"slow": Quantity(int(np.count_nonzero(slow))), "ratio": Quantity(SAMPLING.long)} if slow.any() else {}
    log.notes.append(Note(NoteKind.RESAMPLED, numbers=numbers))


def _refuse_finer(count: float, known: int, period: float) -> None:
    """Refuse a log that resampling would make too large for the memory."""
    if count > max(SAMPLING.finer * known, SAMPLING.small):
        raise RecordingError(
            f"time has steps of {period:.3g} s, but others so long that {known} samples would become {count:.3g} "
            "on uniform time: check the column of time and its unit, or cut the recording there"
        )


def _join(log: Log, parts: Sequence[dict[str, Array]]) -> None:
    """Make a log of its segments."""
    log.values = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    log.starts = _find_starts([len(part["time"]) for part in parts])


def _fill_lost(log: Log, parts: Sequence[dict[str, Array]], usual: float) -> list[dict[str, Array]]:
    """Fill in the few lost samples of segments.

    Position and velocity are interpolated by cubic splines, torque linearly.
    """
    full, places, count = [], [], 0
    for part in parts:
        missing = _count_lost(part["time"], usual)
        _refuse_finer(float(missing.sum()), len(missing), usual)
        places.append(part["time"][:-1][missing > 0] - parts[0]["time"][0])
        full.append(_insert_lost(part, missing) if missing.any() else part)
        count += int(missing.sum())
    if count:
        log.notes.append(_note_times(NoteKind.FILLED, np.concatenate(places), count))
    return full


def _count_lost(time: Array, usual: float) -> Index:
    """Count the lost samples between adjacent times (N,) [s], (N - 1,)."""
    ratio = np.diff(time) / usual
    counts = np.round(ratio).astype(np.intp)
    return np.where((ratio > SAMPLING.long) & (np.abs(ratio - counts) <= SAMPLING.whole), counts - 1, 0)


def _insert_lost(part: dict[str, Array], missing: Index) -> dict[str, Array]:
    known = np.append(0, np.cumsum(missing + 1))  # (N,), places of the samples that there are
    every = np.arange(known[-1] + 1)
    full = {name: np.interp(every, known, part[name]) for name in ("time", "torque")}
    others = _sample_at(full["time"], part)
    for name, values in others.items():
        values[known] = part[name]
    return full | others


def _resample_segment(part: dict[str, Array], period: float) -> dict[str, Array]:
    """Resample a segment to a grid of `period` [s] with the same start."""
    time = part["time"]
    grid = _make_grid(time[0], period, int((time[-1] - time[0]) / period + 1 + 1e-6))
    return _sample_at(grid, part) | {"time": grid, "torque": _average_held(grid, period, time, part["torque"])}


def _sample_at(grid: Array, part: dict[str, Array]) -> dict[str, Array]:
    """Sample a segment, without its torque, at other times (M,): `enabled` is held, others by cubic splines."""
    made = {}
    for name in part.keys() - {"time", "torque"}:
        if name == "enabled":
            made[name] = _hold_on_grid(grid, part["time"], part[name])
        else:
            made[name] = scipy.interpolate.CubicSpline(part["time"], part[name])(grid)
    return made


def _make_grid(start: float, period: float, count: int) -> Array:
    return start + period * np.arange(count, dtype=np.float64)


def _hold_on_grid(grid: Array, time: Array, values: Array) -> Array:
    """Hold values (N,) at time (N,) on a grid (M,)."""
    return np.asarray(values[np.clip(np.searchsorted(time, grid, side="right") - 1, 0, len(time) - 1)])


def _average_held(grid: Array, period: float, time: Array, torque: Array) -> Array:
    """Average over each step of grid (M,) the torque (N,) that is held from one time (N,) to the next."""
    ends = np.append(grid, grid[-1] + period)
    until = np.append(time, max(time[-1], grid[-1]) + 2 * period)
    impulse = np.interp(ends, until, np.append(0.0, np.cumsum(torque * np.diff(until))))  # [N m s]
    return np.diff(impulse) / np.diff(ends)


def average_torque(clock: Array, period: float, time: Array, torque: Array) -> Array:
    """Average torque (N,), held from one time (N,) to the next, over each period of a clock (M,).

    Over a window that varies with time, a mean has another integral than the torque: the change of its first moment
    from period to period is taken off.
    """
    shares = (np.arange(PIECES) + 0.5) / PIECES - 0.5  # of a period, from its middle
    pieces = (clock[:, np.newaxis] + period * (shares + 0.5 - 0.5 / PIECES)).ravel()
    values = _average_held(pieces, period / PIECES, time, torque).reshape(-1, PIECES)
    return np.asarray(values.mean(axis=1) - np.gradient(values @ shares / PIECES))


def _make_seconds(**times: float) -> dict[str, Quantity]:
    return {name: Quantity(float(time), unit="s") for name, time in times.items()}


def _note_times(kind: NoteKind, times: Array, count: int, numbers: Mapping[str, Quantity] | None = None) -> Note:
    """Make a note of so many samples or gaps after some times (M,) [s]."""
    counts = {"count": Quantity(count), "times": Quantity(len(times))}
    return Note(kind, numbers=counts | dict(numbers or {}), places=tuple(times[:NAMED].tolist()))
