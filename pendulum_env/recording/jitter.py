"""Replace late time stamps of uniform samples, and resample an encoder that is slower than its log."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pendulum_env._typing import Array, Index
from pendulum_env.quantity import Quantity
from pendulum_env.recording.cleaning import CLEANING, Log, note_rows
from pendulum_env.recording.clock import STEPS
from pendulum_env.recording.lost_rows import MotionEvidence, Parts, find_levels, find_period
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.sampling import average_torque


@dataclass(frozen=True)
class JitterSettings:
    """Limits on deviations of time stamps from a uniform clock, and on the clock of a slow encoder."""

    pause: float = 5.0  # [periods], least step between parts with separate clocks
    precision: float = 0.1  # [periods], standard error of the steps whose median gives the first period
    most_stamps: int = 50  # most stamps in such a step
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
SPAN = 4  # rows on either side for velocity and for the usual motion, more than for `WEIGHTS`
NEGLIGIBLE = 1e-3  # deviation of a stamp that counts as none [periods]


def replace_late_stamps(logs: Sequence[Log]) -> None:
    """Replace the time stamps of the joints of a file by a fitted uniform clock, if positions show uniform samples.

    Stamps jitter about a uniform clock if their deviations do not accumulate. If the samples jitter too, position
    deviates from a smooth function of the row number by velocity times jitter. An integral of the velocity has the
    jitter of its stamps, so that the velocity takes its place. Lost rows remain gaps. Rounded stamps, and rows that
    arrive in bursts, repeat a time. The last of these rows has that time, which may deviate by up to a step between
    different stamps, also if the deviations accumulate. Otherwise, time is unchanged.
    """
    log = logs[0]
    positions = np.stack([log.values["velocity"] if log.is_integral else log.position for log in logs])
    time = log.values["time"]
    last = np.flatnonzero(np.diff(time, append=np.inf) > 0)  # (M,), last row of each stamp
    stamps, steps, n_rows, has_repeats = time[last], np.diff(time[last]), np.diff(last), len(last) < len(time)
    if has_repeats and len(stamps) <= JITTER.fewest_stamps:
        return
    median_step = float(np.median(steps))
    period = median_step / float(np.median(n_rows))
    errors = np.abs(steps - n_rows * period)
    if not has_repeats and 1.4826 * np.median(errors) / np.sqrt(2.0) <= max(log.resolution, NEGLIGIBLE * period):
        return
    noise = np.sqrt(np.mean(np.minimum(errors, period) ** 2) / 2.0)
    width = int(np.clip(np.ceil(2.0 * (noise / (JITTER.precision * period)) ** 2), 1, JITTER.most_stamps))
    period = float(np.median(stamps[width:] - stamps[:-width]) / np.median(last[width:] - last[:-width]))
    cuts = steps > JITTER.pause * median_step
    if "segment" in log.values:
        cuts |= np.diff(log.values["segment"][last]) != 0
    bounds = pairwise([0, *(np.flatnonzero(cuts) + 1).tolist(), len(stamps)])
    parts = [(a, max(a + 1, b - has_repeats)) for a, b in bounds]  # the last stamp of a part may lack rows
    if not any(b - a > 2 * SPAN for a, b in parts):
        return
    rows = StampedRows(stamps, last, positions, parts)
    clocks = ((period, False), (find_period(stamps, period, parts), True))
    alternatives = product((np.arange(len(time)), log.rows), clocks)
    fits = [rows.fit_clock(numbers, period, has_losses=has_losses) for numbers, (period, has_losses) in alternatives]
    fit = min(fits, key=lambda fit: fit.score)
    successive = np.mean(np.concatenate([np.diff(delay) for delay in fit.delays if len(delay) > 2 * SPAN]) ** 2)
    is_white = successive >= JITTER.least_white * fit.std**2 and fit.std <= JITTER.largest_spread * fit.period
    largest_delay = np.quantile(np.abs(np.concatenate(fit.delays)), 1 - JITTER.quantile)
    if not (is_white or (has_repeats and largest_delay <= median_step)):
        return
    clock = np.repeat(fit.offsets, np.diff([0, *(last[:-1][cuts] + 1).tolist(), len(time)])) + fit.period * fit.counts
    share, error = _estimate_jitter_share(time - clock, clock, fit.period, positions)
    if not share + JITTER.least_z_score * error < JITTER.share_limit:
        return
    for each in logs:
        each.replace_series(time=clock - clock[0] + time[0])
    deviation = Quantity(1e3 * float(np.std(time - clock)), unit="ms")
    log.notes.append(
        Note(NoteKind.STAMPS_LATE, numbers={"rate": Quantity(1 / fit.period, unit="Hz"), "std": deviation})
    )


class ClockFit(NamedTuple):
    """Uniform clock of N rows, fitted to M time stamps.

    Attributes:
        score: BIC, with the place and the size of each loss as parameters.
        period: sample time [s].
        offsets: time of count 0 in each part [s].
        counts: periods from the first row to each row (N,).
        delays: stamps less the clock, of each part [s].
    """

    score: float
    period: float
    offsets: list[float]
    counts: Index
    delays: list[Array]

    @property
    def std(self) -> float:
        """Return the root mean square of the delays [s]."""
        return float(np.sqrt(np.mean(np.concatenate(self.delays) ** 2)))


class StampedRows(NamedTuple):
    """N rows of a log with M different time stamps.

    Attributes:
        stamps: different time stamps (M,) [s].
        last: last row of each stamp (M,).
        positions: position of each of J joints in each row (J, N) [rad].
        parts: first and end of the stamps of each part with its own clock.
    """

    stamps: Array
    last: Index
    positions: Array
    parts: Parts

    def fit_clock(self, numbers: Index, period: float, *, has_losses: bool) -> ClockFit:
        """Fit a uniform clock, with the losses of `count_periods`, which explains the arguments."""
        stamps, counts = self.stamps, self.count_periods(numbers, period) if has_losses else numbers - numbers[0]
        period, offsets = _fit_clock(stamps, counts[self.last], self.parts)
        pairs = zip(self.parts, offsets, strict=True)
        delays = [stamps[a:b] - offset - period * counts[self.last[a:b]] for (a, b), offset in pairs]
        n_losses = np.count_nonzero(np.diff(counts) - np.diff(numbers))
        fit = ClockFit(0.0, period, offsets, counts, delays)
        misfit = len(stamps) * float(np.log(fit.std**2 + (NEGLIGIBLE * period) ** 2))
        return fit._replace(score=misfit + 2 * n_losses * float(np.log(len(stamps))))

    def count_periods(self, numbers: Index, period: float) -> Index:
        """Count the periods (N,) [`period` in s] up to each row, with lost rows, by maximum likelihood.

        Counts exceed the row numbers (N,), which count the periods without lost rows, by a level that rises where rows
        were lost. Stamps deviate from the clock by normal errors. Motion in a step deviates from the median motion of
        its neighbours, times the periods of the step, by errors with long tails. It decides where stamps do not.
        """
        counts, moves = np.diff(numbers), np.diff(self.positions)
        padded = np.pad(moves, ((0, 0), (SPAN, SPAN)), mode="edge")
        neighbours = np.delete(sliding_window_view(padded, 2 * SPAN + 1, axis=1), SPAN, axis=2)
        usual = np.median(neighbours, axis=2) * counts  # motion in a row step without losses
        excess = moves - usual
        scale = np.mean(np.abs(excess), axis=1, keepdims=True)
        scale = np.where(scale > 0, scale, 1.0)
        for begin, stop in self.parts:
            last = self.last[begin:stop]
            deviation = (self.stamps[begin:stop] - self.stamps[begin]) / period - (numbers[last] - numbers[last[0]])
            mean = np.mean(np.exp(2j * np.pi * deviation))
            noise = np.sqrt(max(-np.log(np.abs(mean)) / (2.0 * np.pi**2), NEGLIGIBLE**2))
            deviation -= np.angle(mean) / (2.0 * np.pi)
            steps = slice(last[0], last[-1])
            motion = MotionEvidence(usual[:, steps] / scale, excess[:, steps] / scale)
            counts[steps] += np.diff(find_levels(deviation / noise, last - last[0], 1.0 / noise, motion))
        return np.append(0, np.cumsum(counts))


def _fit_clock(time: Array, counts: Index, parts: Parts) -> tuple[float, list[float]]:
    """Fit time (N,) [s] by counts (N,) of a period and an offset per part; return period and offsets [s]."""
    centred, centred_time = (np.concatenate([x[a:b] - x[a:b].mean() for a, b in parts]) for x in (counts, time))
    period = float(centred @ centred_time / (centred @ centred))
    return period, [float(np.mean(time[a:b] - period * counts[a:b])) for a, b in parts]


def _estimate_jitter_share(delay: Array, clock: Array, period: float, positions: Array) -> tuple[float, float]:
    """Estimate the share of jitter (N,) [s] that is visible in the positions of joints (J, N), and its standard error.

    Shares of joints are averaged with the inverse of their variance.
    """
    shares, errors = np.transpose([_measure_jitter_share(delay, clock, period, position) for position in positions])
    if len(shares) == 1 or not np.isfinite(errors).any():
        return float(shares[0]), float(errors[0])
    weights = 1.0 / np.maximum(errors, 1e-12) ** 2
    return float(shares @ weights / weights.sum()), float(weights.sum() ** -0.5)


def _measure_jitter_share(delay: Array, clock: Array, period: float, position: Array) -> tuple[float, float]:
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


def resample_slow_encoder(log: Log) -> None:
    """Resample a log to the clock of an encoder that is slower than the log and repeats values.

    Position is sampled at the times of this clock. Torque with the same clock is sampled too, other torque is averaged.
    Runs without enough motion to find the times of their samples are dropped. A log with a reference is
    unchanged, because references have another clock.
    """
    if "reference" in log.values:
        return
    time = log.values["time"]
    segment = log.values.get("segment", np.zeros_like(time))
    runs = np.cumsum(np.diff(segment, prepend=segment[0]) != 0)  # labels may recur
    row = float(np.median(np.diff(time)))
    clock = _find_encoder_clock(time, log.position, runs, row)
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
    chain_parts = list(pairwise(np.cumsum([0, *map(len, chains)]).tolist()))
    period, _ = _fit_clock(stamps, counts, chain_parts)
    for (a, b), (_, end) in pairwise(chain_parts):  # aligns the counts of chains to one clock
        offset = np.mean(stamps[b:end] - period * counts[b:end]) - np.mean(stamps[a:b] - period * counts[a:b])
        counts[b:end] += round(float(offset) / period)
    parts = list(pairwise([0, *(np.flatnonzero(np.diff(run)) + 1).tolist(), len(stamps)]))
    period, _ = _fit_clock(stamps, counts, parts)
    delay = stamps - period * counts
    phases = {int(run[a]): float(np.quantile(delay[a:b], JITTER.quantile)) for a, b in parts}
    delay -= np.array([phases[number] for number in run])
    explained = np.mean((delay > -JITTER.early_tolerance * row) & (delay < (1 + JITTER.early_tolerance) * row))
    return (period, phases) if explained >= JITTER.explained_share and period <= STEPS[1] else None
