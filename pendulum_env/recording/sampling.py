"""Make time uniform: fill lost samples, cut at gaps, and resample rounded or uneven time.

Lost samples are filled if the error of interpolation, tested on the recording, is below the sensor noise. Longer gaps
separate segments.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.errors import RecordingError
from pendulum_env.quantity import Quantity
from pendulum_env.recording.cleaning import CLEANING, Log
from pendulum_env.recording.clock import compute_unevenness, is_uniform
from pendulum_env.recording.notes import NAMED, Note, NoteKind


@dataclass(frozen=True)
class SamplingSettings:
    """Limits on gaps to bridge, on uneven steps, and on segments to keep."""

    off_multiple: float = 0.25  # largest distance of a long step with lost samples from a multiple of the median step
    longest_loss: int = 3  # most adjacent lost samples to fill, as torque is unknown there
    noise_ratio: float = 2.0  # largest interpolation error, relative to that due to noise
    fine_error: float = 1e-4  # negligible interpolation error, relative to the range of position
    most_samples: int = 50_000  # most samples for the test of interpolation
    shortest: float = 0.2  # [s], least duration of a segment, for a window of an estimator
    fewest: int = 10  # least number of samples of a segment
    negligible_error: float = 1e-4  # negligible error of time, in steps: 1e-6 rad at 1 kHz and 10 rad/s
    resampling_ratio: int = 10  # largest ratio of resampled to recorded samples
    allowed_samples: int = 1_000_000  # number of resampled samples that is always allowed


SAMPLING = SamplingSettings()
PIECES = 8  # of a period, by which torque is summed up


def cut_at_gaps(logs: Sequence[Log]) -> None:
    """Start a segment of the joints of a file after each gap of time, and at each change of the column `segment`."""
    log = logs[0]
    segments, time = log.values.get("segment"), log.values["time"]
    segment_starts = set() if segments is None else set((np.flatnonzero(np.diff(segments)) + 1).tolist())
    steps = np.diff(time)
    median_step = float(np.median(steps))
    gaps = np.empty(0, dtype=np.intp)
    if steps.max() > CLEANING.long_step * median_step and not _are_rounded(logs):
        n_bridgeable = min(count_bridgeable(time, each.position) for each in logs)
        gaps = np.flatnonzero(steps > (n_bridgeable + CLEANING.long_step) * median_step) + 1
    new_starts = [int(gap) for gap in gaps if gap not in segment_starts]
    if new_starts:
        sizes = steps[np.array(new_starts) - 1]
        numbers = _make_seconds(shortest=sizes.min(), longest=sizes.max())
        log.notes.append(_note_times(NoteKind.GAPS, time[new_starts] - sizes - time[0], len(new_starts), numbers))
    for each in logs:
        each.values = {quantity: column for quantity, column in each.values.items() if quantity != "segment"}
        each.starts = tuple(sorted({0, *segment_starts, *new_starts}))


def drop_short_segments(log: Log) -> None:
    """Remove segments that are too short for an estimate."""
    time = log.values["time"]
    parts = list(pairwise((*log.starts, len(time))))
    is_kept = [b - a >= SAMPLING.fewest and time[b - 1] - time[a] >= SAMPLING.shortest for a, b in parts]
    if not any(is_kept):
        subject = "the recording does not last" if len(is_kept) == 1 else f"none of its {len(is_kept)} segments lasts"
        raise RecordingError(f"{subject} {SAMPLING.shortest:g} s without a gap: record longer, without losing samples")
    short = [b - a for (a, b), is_long in zip(parts, is_kept, strict=True) if not is_long]
    if short:
        numbers = {"count": Quantity(len(short)), "samples": Quantity(sum(short))}
        log.notes.append(Note(NoteKind.SHORT_SEGMENTS, numbers=numbers | _make_seconds(least=SAMPLING.shortest)))
        lengths = [b - a for a, b in parts]
        log.keep_rows(np.repeat(is_kept, lengths))
        log.starts = _find_starts([length for length, is_long in zip(lengths, is_kept, strict=True) if is_long])


def _find_starts(lengths: Sequence[int]) -> tuple[int, ...]:
    """Return the indices of the first samples of consecutive segments with given lengths."""
    return tuple(np.cumsum([0, *lengths[:-1]]).tolist())


def _are_rounded(logs: Sequence[Log]) -> bool:
    """Return whether long steps of the time of some joints are due to rounding, see `is_rounded`."""
    return all(is_rounded(log.values["time"], log.position, log.resolution) for log in logs)


def is_rounded(time: Array, position: Array, resolution: float) -> bool:
    """Return whether long steps of time (N,) [s] are due to rounding: regular, and without effect on position.

    `resolution` is the last decimal place of printed time [s].
    """
    steps = np.diff(time)
    median_step = float(np.median(steps))
    places = np.flatnonzero(steps > CLEANING.long_step * median_step)
    is_regular = len(places) > 2 and np.ptp(np.diff(places)) <= 1
    return bool(is_regular and resolution > median_step / 2 and not has_lost_samples(time, position))


def has_lost_samples(time: Array, position: Array) -> bool:
    """Return whether position (N,) changes more in long steps of time (N,) than in other steps.

    Rounding also causes long steps, but without larger changes of position.
    """
    steps, moves = np.diff(time), np.diff(position)
    long_steps = np.flatnonzero(steps[1:-1] > CLEANING.long_step * float(np.median(steps))) + 1
    neighbour_moves = 0.5 * (moves[long_steps - 1] + moves[long_steps + 1])
    return bool(moves[long_steps] @ neighbour_moves > CLEANING.long_step * (neighbour_moves @ neighbour_moves))


def count_bridgeable(time: Array, position: Array) -> int:
    """Return the largest number of adjacent lost samples that interpolation can fill within noise.

    For each number, as many samples are removed everywhere in an intact part of position (N,). The middle one is
    interpolated by the cubic through two samples on either side.
    """
    steps = np.diff(time)
    q = position[_find_longest_run(steps <= CLEANING.long_step * float(np.median(steps)))]
    if len(q) < 20:
        return 0
    noise = float(np.std(np.diff(q, 6))) / np.sqrt(924.0)  # 924: sum of squares of 1, -6, 15, ...
    for n_lost in range(1, SAMPLING.longest_loss + 1):
        nodes, middle = np.array([-1, 0, n_lost + 1, n_lost + 2]), (n_lost + 1) // 2
        weights = np.array([np.prod([(middle - b) / (a - b) for b in nodes if b != a]) for a in nodes])  # Lagrange
        span = len(q) - (n_lost + 3)
        guess = sum(w * q[1 + k : 1 + k + span] for w, k in zip(weights, nodes, strict=True))
        error = float(np.std(q[1 + middle : 1 + middle + span] - guess))
        allowed = SAMPLING.noise_ratio * noise * np.sqrt(1 + weights @ weights)
        if error > max(allowed, SAMPLING.fine_error * float(np.ptp(q))):
            return n_lost - 1
    return SAMPLING.longest_loss


def _find_longest_run(is_good: Mask) -> slice:
    """Return the slice of the longest run of good steps (N - 1,), at most `SAMPLING.intact` samples."""
    edges = np.flatnonzero(np.diff(is_good, prepend=False, append=False))
    first, end = edges[::2], edges[1::2]
    if not len(first):
        return slice(0, 0)
    longest = int(np.argmax(end - first))
    return slice(int(first[longest]), int(min(end[longest] + 1, first[longest] + SAMPLING.most_samples)))


def resample_uniformly(logs: Sequence[Log]) -> None:
    """Resample the series of the joints of a file to uniform time with one period in all segments.

    Lost samples are filled first. If time is uniform up to rounding, the series are unchanged. Otherwise position and
    velocity are interpolated by cubic splines. Torque, which is held between samples, is averaged over each new step,
    which keeps its impulse.
    """
    log = logs[0]
    if is_uniform(log.values["time"], log.starts):
        return
    parts = _split(log)
    median_step = float(np.median(np.concatenate([np.diff(part["time"]) for part in parts])))
    if len(parts) > 1 or not _are_rounded(logs):
        for each in logs:
            _fill_lost(each, median_step)
        parts = _split(log)
    time = log.values["time"]
    if is_uniform(time, log.starts):
        return
    steps = np.concatenate([np.diff(part["time"]) for part in parts])
    is_slow = steps > CLEANING.long_step * median_step
    period = float(np.mean(steps))
    unevenness = max(compute_unevenness(part["time"], period) for part in parts)
    has_loss = len(parts) == 1 and any(has_lost_samples(time, each.values["position"]) for each in logs)
    if unevenness <= max(1.001 * log.resolution + log.rounding, SAMPLING.negligible_error * period) and not has_loss:
        grids = [_make_grid(part["time"][0], period, len(part["time"])) for part in parts]
        for each in logs:
            each.replace_series(time=np.concatenate(grids))
        if unevenness > log.rounding:
            rate = {"rate": Quantity(1 / period, unit="Hz")}
            log.notes.append(Note(NoteKind.CLOCK_ROUNDED, numbers=rate | _make_seconds(error=unevenness)))
        return
    if is_slow.any():
        period = float(np.mean(steps[~is_slow]))
    _refuse_too_many(sum(float(part["time"][-1] - part["time"][0]) for part in parts) / period, len(time), period)
    for each in logs:
        _join(each, [_resample_segment(part, period) for part in _split(each)])
    numbers = {"rate": Quantity(1 / period, unit="Hz")}
    sizes = {"shortest": steps.min(), "longest": steps.max(), "std": steps.std()}
    numbers |= {name: Quantity(1e3 * float(size), unit="ms") for name, size in sizes.items()}
    if is_slow.any():
        numbers |= {"slow": Quantity(int(np.count_nonzero(is_slow))), "ratio": Quantity(CLEANING.long_step)}
    log.notes.append(Note(NoteKind.RESAMPLED, numbers=numbers))


def _refuse_too_many(count: float, n_recorded: int, period: float) -> None:
    """Refuse a log that would have too many samples after resampling."""
    if count > max(SAMPLING.resampling_ratio * n_recorded, SAMPLING.allowed_samples):
        raise RecordingError(
            f"time has steps of {period:.3g} s, but others so long that {n_recorded} samples would become {count:.3g} "
            "on uniform time: check the column of time and its unit, or cut the recording there"
        )


def _split(log: Log) -> list[dict[str, Array]]:
    """Return the series of each segment of a log."""
    bounds = pairwise((*log.starts, len(log.values["time"])))
    return [{name: column[a:b] for name, column in log.values.items()} for a, b in bounds]


def _join(log: Log, parts: Sequence[dict[str, Array]]) -> None:
    """Replace the series of a log by its segments."""
    log.values = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    log.starts = _find_starts([len(part["time"]) for part in parts])


def _fill_lost(log: Log, median_step: float) -> None:
    """Fill the lost samples of each segment.

    Position and velocity are interpolated by cubic splines, torque linearly.
    """
    parts = _split(log)
    filled_parts, places, count = [], [], 0
    for part in parts:
        n_lost = _count_lost(part["time"], median_step)
        _refuse_too_many(float(n_lost.sum()), len(n_lost), median_step)
        places.append(part["time"][:-1][n_lost > 0] - parts[0]["time"][0])
        filled_parts.append(_insert_lost(part, n_lost) if n_lost.any() else part)
        count += int(n_lost.sum())
    if count:
        log.notes.append(_note_times(NoteKind.FILLED, np.concatenate(places), count))
    _join(log, filled_parts)


def _count_lost(time: Array, median_step: float) -> Index:
    """Return the number of lost samples (N - 1,) between adjacent times (N,) [s]."""
    ratio = np.diff(time) / median_step
    counts = np.round(ratio).astype(np.intp)
    is_lossy = (ratio > CLEANING.long_step) & (np.abs(ratio - counts) <= SAMPLING.off_multiple)
    return np.where(is_lossy, counts - 1, 0)


def _insert_lost(part: dict[str, Array], n_lost: Index) -> dict[str, Array]:
    recorded = np.append(0, np.cumsum(n_lost + 1))  # (N,), indices of the recorded samples
    rows = np.arange(recorded[-1] + 1)
    filled = {name: np.interp(rows, recorded, part[name]) for name in ("time", "torque")}
    sampled = _sample_at(filled["time"], part)
    for name, values in sampled.items():
        values[recorded] = part[name]
    return filled | sampled


def _resample_segment(part: dict[str, Array], period: float) -> dict[str, Array]:
    """Resample a segment to a grid of `period` [s] with the same start."""
    time = part["time"]
    grid = _make_grid(time[0], period, int((time[-1] - time[0]) / period + 1 + 1e-6))
    return _sample_at(grid, part) | {"time": grid, "torque": _average_held(grid, period, time, part["torque"])}


def _sample_at(grid: Array, part: dict[str, Array]) -> dict[str, Array]:
    """Sample a segment without torque at times (M,): `enabled` is held, others are splined."""
    sampled = {}
    for name in part.keys() - {"time", "torque"}:
        if name == "enabled":
            sampled[name] = part[name][np.clip(np.searchsorted(part["time"], grid, side="right") - 1, 0, None)]
        else:
            sampled[name] = scipy.interpolate.CubicSpline(part["time"], part[name])(grid)
    return sampled


def _make_grid(start: float, period: float, count: int) -> Array:
    return start + period * np.arange(count, dtype=np.float64)


def _average_held(grid: Array, period: float, time: Array, torque: Array) -> Array:
    """Average torque (N,), held from times (N,) on, over each step of a grid (M,)."""
    ends = np.append(grid, grid[-1] + period)
    ends_of_torque = np.append(time, max(time[-1], grid[-1]) + 2 * period)
    impulse = np.interp(ends, ends_of_torque, np.append(0.0, np.cumsum(torque * np.diff(ends_of_torque))))  # [N m s]
    return np.diff(impulse) / np.diff(ends)


def average_torque(clock: Array, period: float, time: Array, torque: Array) -> Array:
    """Average torque (N,), held from one time (N,) to the next, over each period of a clock (M,).

    Under a window that varies with time, the mean has another integral than the torque. The change of its first moment
    from period to period corrects the mean.
    """
    shares = (np.arange(PIECES) + 0.5) / PIECES - 0.5  # of a period, from its middle
    pieces = (clock[:, np.newaxis] + period * (shares + 0.5 - 0.5 / PIECES)).ravel()
    values = _average_held(pieces, period / PIECES, time, torque).reshape(-1, PIECES)
    return np.asarray(values.mean(axis=1) - np.gradient(values @ shares / PIECES))


def _make_seconds(**times: float) -> dict[str, Quantity]:
    return {name: Quantity(float(time), unit="s") for name, time in times.items()}


def _note_times(kind: NoteKind, times: Array, count: int, numbers: Mapping[str, Quantity] | None = None) -> Note:
    """Make a note of a number of samples or gaps after times (M,) [s]."""
    counts = {"count": Quantity(count), "times": Quantity(len(times))}
    return Note(kind, numbers=counts | dict(numbers or {}), places=tuple(times[:NAMED].tolist()))
