"""Replace late time stamps of uniform samples, and resample an encoder that is slower than its log."""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from pendulum_env._typing import Array, Index
from pendulum_env.quantity import Quantity
from pendulum_env.recording.cleaning import CLEANING, Log, note_rows
from pendulum_env.recording.clock import STEPS
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.sampling import average_torque


@dataclass(frozen=True)
class JitterSettings:
    """Limits on deviations of time stamps from a uniform clock, and on the clock of a slow encoder."""

    pause: float = 5.0  # [periods], least step between parts with separate clocks
    precision: float = 0.1  # [periods], standard error of the shift of the clock across a possible loss
    most_rows: int = 50  # most rows on either side in the mean of this shift
    fewest_stamps: int = 100  # least number of steps between stamps that repeat: rounding moves a clock by 1 / n^2
    least_white: float = 1.0  # least mean square of successive differences over the variance: 2 if white, 0 if summed
    largest_spread: float = 0.5  # [periods], largest standard deviation of the stamps
    least_z_score: float = 4.0  # [standard errors], least distance of the share of jitter from `share_limit`
    share_limit: float = 0.5  # limit of the share of jitter in the motion: 0 for late stamps, 1 for jittery sampling
    quantile: float = 0.01  # quantile that gives the smallest step and the smallest delay of rows, robust to outliers
    slowest_period: float = 1.05  # [rows], least period of a slow encoder
    shortest_chain: int = 5  # least number of consecutive changes that determine the clock of an encoder
    early_tolerance: float = 0.1  # [rows], tolerance of samples before their time
    explained_share: float = 0.95  # least share of changes in the first row after a sample's time


JITTER = JitterSettings()
WEIGHTS = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0  # interpolation by the cubic through two samples on either side
SPAN = 4  # rows on either side for velocity, more than for `WEIGHTS`


def replace_late_stamps(log: Log, position: Array) -> None:
    """Replace time stamps by a fitted uniform clock, if position (N,) shows uniform samples.

    Stamps jitter about a uniform clock if their deviations do not accumulate. If the samples jitter too, position
    deviates from a smooth function of the row number by velocity times jitter. Lost rows remain gaps. Rounded stamps
    and rows that arrive in bursts repeat times; they deviate by at most a step between different stamps. Otherwise,
    time is unchanged.
    """
    time = log.values["time"]
    steps = np.diff(time)
    median_step = float(np.median(steps[steps > 0]))
    has_repeats = bool((steps == 0).any())
    burst = float(np.median(np.diff(np.flatnonzero(steps)))) if has_repeats else 1.0  # [rows] of one stamp
    noise = 1.4826 * float(np.median(np.abs(steps - median_step))) / np.sqrt(2.0)
    if not has_repeats and noise <= max(log.resolution, 1e-3 * median_step):
        return
    if has_repeats and JITTER.fewest_stamps * median_step > time[-1] - time[0]:
        return
    width = int(np.clip(np.ceil(2.0 * (noise / (JITTER.precision * median_step)) ** 2), 1, JITTER.most_rows))
    width = round(burst * np.ceil(JITTER.most_rows / burst)) if has_repeats else width  # whole bursts
    period = float(np.median(time[width:] - time[:-width])) / width
    cuts = steps > JITTER.pause * burst * period
    if "segment" in log.values:
        cuts |= np.diff(log.values["segment"]) != 0
    bounds = [0, *(np.flatnonzero(cuts) + 1).tolist(), len(time)]
    parts = [(a, b) for a, b in pairwise(bounds) if b - a > 2 * SPAN]
    if not parts:
        return
    fits = []
    moves, n_stamps = np.diff(position), np.count_nonzero(steps) + 1
    for row_steps, width_of_shift in product((np.ones_like(log.rows[1:]), np.diff(log.rows)), (0, width)):
        counts, n_lost = [], 0
        for a, b in pairwise(bounds):
            known = row_steps[a : b - 1]
            counts.append(_count_periods(time[a:b], moves[a : b - 1], known, period, width_of_shift))
            n_lost += int(counts[-1][-1] - known.sum())
        clock, step = _fit_clock(time, np.concatenate(counts), bounds)
        penalty = 2 * n_lost * np.log(n_stamps)  # BIC: place and size of each loss
        fits.append((float(n_stamps * np.log(np.var(time - clock)) + penalty), step, clock))
    _, step, clock = min(fits, key=lambda fit: fit[0])
    delay = time - clock
    variance = float(np.var(delay))
    successive = np.mean(np.concatenate([np.diff(delay[a:b]) for a, b in parts]) ** 2)
    is_white = successive >= JITTER.least_white * variance and np.sqrt(variance) <= JITTER.largest_spread * step
    is_bounded = has_repeats and np.quantile(np.abs(delay), 1 - JITTER.quantile) <= max(median_step, step)
    if not (is_white or is_bounded):
        return
    share, error = _estimate_jitter_share(delay, clock, step, position)
    if not share + JITTER.least_z_score * error < JITTER.share_limit:
        return
    log.values = {**log.values, "time": clock - clock[0] + time[0]}
    numbers = {"rate": Quantity(1 / step, unit="Hz"), "std": Quantity(1e3 * float(np.sqrt(variance)), unit="ms")}
    log.notes.append(Note(NoteKind.STAMPS_LATE, numbers=numbers))


def _count_periods(time: Array, moves: Array, row_steps: Index, period: float, width: int) -> Index:
    """Count the periods (N,) from the first to each time (N,) of a part.

    `row_steps` (N - 1,) holds the periods between rows without lost rows. With `width` above 0, lost rows are searched:
    after a long step, the mean deviation of the clock over `width` rows increases by a period or more. Larger steps are
    tried first. The loss is assigned to the step with the largest excess of motion `moves` (N - 1,) over its
    neighbours.
    """
    counts = row_steps.copy()
    if width and len(time) > 2:
        sums = np.append(0.0, np.cumsum(time - period * np.append(0, np.cumsum(counts))))
        rows = np.arange(1, len(time))
        first, end = np.maximum(rows - width, 0), np.minimum(rows + width, len(time))
        shifts = (sums[end] - sums[rows]) / (end - rows) - (sums[rows] - sums[first]) / (rows - first)
        steps = np.diff(time)
        places = np.flatnonzero((steps > CLEANING.long_step * period) & (shifts > 0.5 * period))
        around = np.pad(moves, 1, mode="edge")
        excess = (moves - 0.5 * (around[:-2] + around[2:])) * np.sign(around[:-2] + around[2:])
        for k in places[np.argsort(-steps[places], kind="stable")]:
            a, b = first[k], end[k]
            deviation = time[a:b] - period * np.append(0, np.cumsum(counts[a : b - 1]))
            shift = deviation[k + 1 - a :].mean() - deviation[: k + 1 - a].mean()
            n_lost = max(0, round(float(shift) / period))
            near = slice(max(0, k - width // 2), k + 1 + width // 2)
            counts[near.start + int(np.argmax(np.where(counts[near] > 1, -np.inf, excess[near])))] += n_lost
    return np.append(0, np.cumsum(counts))


def _fit_clock(time: Array, counts: Index, bounds: list[int]) -> tuple[Array, float]:
    """Fit time (N,) [s] by counts (N,) of a period and an offset per part; return fit (N,) [s] and period [s]."""
    lengths = np.diff(bounds)
    means = [np.repeat([values[a:b].mean() for a, b in pairwise(bounds)], lengths) for values in (time, counts)]
    centred = counts - means[1]
    period = float(centred @ (time - means[0]) / (centred @ centred))
    return means[0] + period * centred, period


def _estimate_jitter_share(delay: Array, clock: Array, period: float, position: Array) -> tuple[float, float]:
    """Estimate the share of jitter (N,) [s] that is visible in position (N,), and its standard error.

    Only samples of fast motion with all neighbours are used; `clock` (N,) [s] has the given period [s].
    """
    is_complete = clock[2 * SPAN :] - clock[: -2 * SPAN] < (2 * SPAN + 0.5) * period
    velocity = (position[2 * SPAN :] - position[: -2 * SPAN]) / (2 * SPAN * period)

    def find_deviation(values: Array) -> Array:
        return (values - np.convolve(values, WEIGHTS, mode="same"))[SPAN:-SPAN]

    if not is_complete.any():
        return 1.0, np.inf
    is_fast = is_complete & (velocity**2 >= np.mean(velocity[is_complete] ** 2))
    jitter, deviation = (velocity * find_deviation(delay))[is_fast], find_deviation(position)[is_fast]
    power = float(jitter @ jitter)
    if not power > 0 or len(jitter) < 2 * SPAN:
        return 1.0, np.inf
    share = float(jitter @ deviation) / power
    return share, float(np.std(deviation - share * jitter)) / np.sqrt(power)


def resample_slow_encoder(log: Log, position: Array) -> None:
    """Resample a log to the clock of an encoder that is slower than the log and repeats values.

    Position is sampled at the times of this clock. Torque with the same clock is sampled too, other torque is averaged.
    Runs without enough motion to find the times of their samples are dropped. A log with a reference is
    unchanged, because goals have another clock.
    """
    if "reference" in log.values:
        return
    time = log.values["time"]
    segment = log.values.get("segment", np.zeros_like(time))
    runs = np.cumsum(np.diff(segment, prepend=segment[0]) != 0)  # labels may recur
    row = float(np.median(np.diff(time)))
    clock = _find_encoder_clock(time, position, runs, row)
    if clock is None:
        return
    period, phases = clock
    grids, rows = list[Array](), list[Index]()
    torques: dict[str, list[Array]] = {quantity: [] for quantity in ("torque", "load_torque") if quantity in log.values}
    for number, phase in phases.items():
        run_rows = np.flatnonzero(runs == number)
        stamps, margin = time[run_rows], min(JITTER.early_tolerance * row, (period - row) / 2)  # margin within a row
        start = stamps[0] + (phase - stamps[0] + margin) % period - margin
        grid = np.arange(start, stamps[-1] - margin, period)
        places = np.searchsorted(stamps, grid + margin)
        is_seen = stamps[places] - grid < CLEANING.long_step * row
        grids.append(grid[is_seen])
        rows.append(run_rows[places[is_seen]])
        for quantity, parts in torques.items():
            values = log.values[quantity][run_rows]
            # time from the last sample to each change, and changes in rows without a new sample
            elapsed = (stamps[1:][np.diff(values) != 0] - start + margin) % period - margin
            is_late = elapsed > (1 - JITTER.quantile) * row
            is_held = np.count_nonzero(is_late) <= (1 - JITTER.explained_share) * (1 - row / period) * len(is_late)
            parts.append((values[places] if is_held else average_torque(grid, period, stamps, values))[is_seen])
    if not (has_clock := np.isin(runs, list(phases))).all():
        log.notes.append(note_rows(NoteKind.SPOILT, log.rows[~has_clock], "position", text="of unknown time"))
    if "segment" in log.values:
        log.values["segment"] = runs.astype(np.float64)
    samples, sample_rows = np.concatenate(grids), np.concatenate(rows)
    log.values = {quantity: column[sample_rows] for quantity, column in log.values.items()}
    log.values |= {quantity: np.concatenate(parts) for quantity, parts in torques.items()}
    log.values["time"], log.rows, log.start = samples - samples[0], log.rows[sample_rows], log.start + float(samples[0])
    numbers = {"rate": Quantity(1 / period, unit="Hz"), "rows": Quantity(period / row)}
    log.notes.append(Note(NoteKind.ENCODER_SLOW, ("position",), numbers))


def _find_encoder_clock(time: Array, position: Array, runs: Index, row: float) -> tuple[float, dict[int, float]] | None:
    """Find the clock of an encoder that is slower than its log.

    Position (N,) that moves by several smallest steps has a new value with each sample of the encoder. If other rows
    repeat the last value, and new values are in the first rows after the times of a uniform clock, this is the clock.
    Rows are `row` [s] apart.

    Returns:
        period [s], and the time of a sample [s] per run with at least `JITTER.shortest_chain` changes in fast motion;
        None if the encoder has no uniform clock.
    """
    changes = np.flatnonzero(np.diff(position)) + 1
    if len(changes) < CLEANING.least_steps:
        return None
    moves = np.diff(position)[changes - 1]
    sizes = np.abs(moves)
    least_move = max(float(np.quantile(sizes, JITTER.quantile)), float(np.median(np.abs(np.diff(moves)))))
    is_fast = np.minimum(sizes[1:], sizes[:-1]) >= CLEANING.moving_ratio * least_move
    is_fast &= np.diff(runs[changes]) == 0
    spacing = np.diff(changes)[is_fast]
    if len(spacing) < CLEANING.least_steps:
        return None
    mean = float(np.mean(np.minimum(spacing, 2 * np.median(spacing))))
    bounds = [0, *(np.flatnonzero(~is_fast) + 1).tolist(), len(changes)]
    chains = [changes[a:b] for a, b in pairwise(bounds) if b - a >= JITTER.shortest_chain]
    if mean < JITTER.slowest_period or not chains:
        return None
    rows = np.concatenate(chains)
    stamps, run = time[rows], runs[rows]
    spacing = np.concatenate([np.diff(chain, prepend=chain[0]) for chain in chains])
    counts = np.cumsum(np.where(spacing < mean + 1, 1, np.round(spacing / mean))).astype(np.intp)  # values may repeat
    ends = np.cumsum([0, *map(len, chains)]).tolist()
    _, period = _fit_clock(stamps, counts, ends)
    for (a, b), (_, end) in pairwise(pairwise(ends)):  # aligns the counts of chains to one clock
        offset = np.mean(stamps[b:end] - period * counts[b:end]) - np.mean(stamps[a:b] - period * counts[a:b])
        counts[b:end] += round(float(offset) / period)
    parts = [0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(stamps)]
    _, period = _fit_clock(stamps, counts, parts)
    delay = stamps - period * counts
    phases = {int(run[a]): float(np.quantile(delay[a:b], JITTER.quantile)) for a, b in pairwise(parts)}
    delay -= np.array([phases[number] for number in run])
    explained = np.mean((delay > -JITTER.early_tolerance * row) & (delay < (1 + JITTER.early_tolerance) * row))
    return (period, phases) if explained >= JITTER.explained_share and period <= STEPS[1] else None
