"""Remove invalid rows: empty cells, repeated times, glitches of one sample and stale values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.errors import RecordingError
from pendulum_env.quantity import Quantity
from pendulum_env.recording.clock import find_resolution
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.notes import NAMED, Note, NoteKind
from pendulum_env.recording.vocabulary import QUANTITIES

OPTIONAL = QUANTITIES[3:]  # optional quantities
TURN = 2 * np.pi  # [rad]
WRAPPED_RANGE = 1.016  # range of a wrapped position, in turns, with noise
REFERENCE_STEP = 0.125  # turns between two samples from which a change of the reference is a step
TRAVEL_ROWS = 5  # rows over which travel is measured, to find a joint that stands still
ROUNDING = 1e-9  # least step, share of the range: smaller ones are rounding errors
HELD = ("torque", "enabled")  # quantities that are held until the next value


@dataclass(frozen=True)
class CleaningSettings:
    """Limits of glitches, stale values and repeated times."""

    largest_number: float = 1e20  # magnitude that counts as infinite, above time in nanoseconds since 1970
    glitch_ratio: float = 10.0  # ratio of a glitch's deviation to those of its neighbours and of the recording
    restart_gap: float = 1.0  # [s], gap between runs whose clocks restart
    long_step: float = 1.5  # least length of a step with lost rows, in median steps
    moving_ratio: float = 3.0  # least ratio of a moving joint's step to the usual deviation from steady motion
    jump_ratio: float = 3.0  # least ratio of an impossible jump to the steps around it, and of unsteady travels
    repeated_step: float = 1e-6  # largest step of a repeated time, as share of the median step
    least_moved: float = 0.5  # least share of moved rows among those that repeat a time, relative to other rows
    smooth_ratio: float = 3.0  # least fall of the roughness without a stale value
    slow_encoder: float = 0.5  # least share of repeats beside another repeat, from which the encoder is slow
    short_run: int = 2  # most stale values in a row that show by roughness
    least_counts: float = 5.0  # least step of a joint whose stale values show by roughness [counts of the encoder]
    steady_tolerance: float = 0.25  # largest relative difference of equal steps
    lost_ratio: float = 1.5  # least ratio of steps across lost cells to steps between rows
    least_tilt: float = 0.2  # [rad], least angle from equilibrium of a joint that is held
    longest_hold: float = 0.1  # [s], twice the shortest initial hold
    held_share: float = 0.99  # least angle of a raised joint in a hold, share of the largest angle
    rest_share: float = 0.8  # share of a hold, at its middle, in which the joint rests
    rest_ratio: float = 5.0  # largest deviation from its mean of a velocity at rest [standard deviations]
    least_steps: int = 20  # least number of smallest steps of a column with rounded values


CLEANING = CleaningSettings()


@dataclass
class Log:
    """Content of a file during cleaning.

    Attributes:
        values: series in SI units by quantity, (N,) each.
        notes: notes on changes.
        starts: index of the first sample of each segment.
        rows: row of each sample in the file (N,), from 1, without the header.
        start: first time in the log [s].
        resolution: last decimal place of printed time, or spacing of float32 [s]; 0 if unknown.
        rounding: rounding error of float64 at these times [s].
        turns: turn at which position and reference may be wrapped [rad], see `find_turns`.
        unwraps: whether jumps of a turn are undone.
        is_integral: whether the position is the integral of the velocity.
    """

    values: dict[str, Array]
    notes: list[Note] = field(default_factory=list)
    starts: tuple[int, ...] = (0,)
    start: float = 0.0
    resolution: float = 0.0
    rounding: float = 0.0
    turns: Mapping[str, float] = field(default_factory=dict)
    unwraps: bool = False
    is_integral: bool = False

    def __post_init__(self) -> None:
        self.rows: Index = np.arange(1, len(self.values["time"]) + 1)

    @property
    def position(self) -> Array:
        """Return the position (N,) [rad], without jumps of a turn if these are undone."""
        position = self.values["position"]
        return np.unwrap(position, period=self.turns["position"]) if self.unwraps else position

    def replace_series(self, **series: Array) -> None:
        """Replace series (N,), such as the time, and integrate the velocity again if the position is its integral."""
        self.values = {**self.values, **series}
        if self.is_integral:
            integral = integrate_velocity(self.values["time"], self.values["velocity"])
            self.values["position"] = self.values["position"][0] + integral

    def keep_rows(self, is_kept: Mask) -> None:
        """Keep the samples of a mask (N,)."""
        self.values = {quantity: column[is_kept] for quantity, column in self.values.items()}
        self.rows = self.rows[is_kept]


def integrate_velocity(time: Array, velocity: Array) -> Array:
    """Return the integral (N,) of the velocity by the trapezoidal rule, from zero."""
    steps = 0.5 * np.diff(time, prepend=time[:1]) * (velocity + np.concatenate([velocity[:1], velocity[:-1]]))
    return np.cumsum(steps)


def fill_unchanged(log: Log) -> None:
    """Fill empty cells with the last value in files that are written only at changes.

    A column that is written in each row repeats its value about half as often as it changes by its smallest step. A
    file is therefore written at changes if a column takes many smallest steps, and no column with empty cells repeats a
    value. If the steps of such a column are larger across empty cells than between rows, its cells were lost. The
    columns `enabled` and `segment` are always held.
    """
    sparse = [quantity for quantity in log.values if quantity != "time" and np.isnan(log.values[quantity]).any()]
    steps = {quantity: np.diff(log.values[quantity][~np.isnan(log.values[quantity])]) for quantity in sparse}
    held_quantities = [quantity for quantity in sparse if quantity in ("enabled", "segment")]
    open_quantities = [quantity for quantity in sparse if quantity not in held_quantities]
    if all(steps[quantity].all() for quantity in open_quantities) and any(
        _is_coarse(steps[quantity]) and not _is_lost(log.values[quantity]) for quantity in open_quantities
    ):
        held_quantities += open_quantities
        log.notes.append(Note(NoteKind.CELLS_HELD))
    for quantity in held_quantities:
        log.values[quantity] = _hold_values(log.values[quantity], ~np.isnan(log.values[quantity]))


def _hold_values(values: Array, is_known: Mask) -> Array:
    """Hold the last known values (N,), with NaN before the first known one; `is_known` is a mask (N,)."""
    last_known = np.maximum.accumulate(np.where(is_known, np.arange(len(values)), -1))
    return np.where(last_known >= 0, values[last_known], np.nan)


def _is_coarse(steps: Array) -> bool:
    """Return whether many steps (M,) of a column equal its smallest step."""
    if not steps.any():
        return False
    sizes = np.abs(steps)
    return int(np.count_nonzero(sizes <= 1.5 * sizes[sizes > 0].min())) >= CLEANING.least_steps


def _is_lost(values: Array) -> bool:
    """Return whether a column (N,) has larger steps across empty cells than between rows."""
    rows = np.flatnonzero(~np.isnan(values))
    is_across, sizes = np.diff(rows) > 1, np.abs(np.diff(values[rows]))
    if not is_across.any() or np.count_nonzero(~is_across) < CLEANING.least_steps:
        return False
    return bool(sizes[is_across].mean() > CLEANING.lost_ratio * sizes[~is_across].mean())


def align_topics(log: Log, fewest: int) -> None:
    """Move quantities in separate rows to the rows of position, as of merged topics.

    Quantities in `HELD` are held, others interpolated. With fewer than `fewest` rows of position, nothing is changed,
    and `drop_invalid_rows` raises the error.
    """
    values = dict(log.values)
    has_position = np.isfinite(values["position"])
    if np.count_nonzero(has_position) < fewest:
        return
    notes = list[Note]()
    for quantity in sorted(values.keys() - {"time", "position", "segment"}):
        is_valid = np.isfinite(values[quantity]) & np.isfinite(values["time"])
        shared = np.count_nonzero(is_valid & has_position)
        if has_position.all() or shared > 0.5 * min(np.count_nonzero(has_position), np.count_nonzero(is_valid)):
            continue
        if quantity in HELD:
            values[quantity] = _hold_values(values[quantity], is_valid)
        elif is_valid.any():
            values[quantity] = np.interp(values["time"], values["time"][is_valid], values[quantity][is_valid])
        notes.append(Note(NoteKind.OTHER_ROWS, (quantity,), text="held" if quantity in HELD else "interpolated"))
    if notes:
        log.values = values
        log.keep_rows(has_position)
        log.notes += notes


def drop_invalid_rows(log: Log, fewest: int) -> None:
    """Remove rows with empty cells, NaN or numbers above `CLEANING.largest_number`.

    An optional column with more than half of its cells missing is removed instead; not a velocity whose integral is the
    position.
    """
    count, optional = len(log.values["time"]), {*OPTIONAL} - {"velocity"} if log.is_integral else {*OPTIONAL}
    is_kept, columns = np.ones(count, dtype=np.bool_), {}
    spoilt: dict[tuple[str, bytes], list[str]] = {}  # quantities by fault and mask of valid rows
    for quantity, column in log.values.items():
        is_valid = np.abs(column) < CLEANING.largest_number
        if is_valid.all():
            columns[quantity] = column
            continue
        n_invalid = count - int(np.count_nonzero(is_valid))
        first = int(np.argmin(is_valid))
        fault = "empty or NaN" if np.isnan(column[first]) else "infinite"
        if quantity in optional and n_invalid > count / 2:
            numbers = {"count": Quantity(n_invalid), "rows": Quantity(count)}
            log.notes.append(Note(NoteKind.SPARSE, (quantity,), numbers, text=fault))
            continue
        if count - n_invalid < min(fewest, count / 2):
            raise RecordingError(
                f"data row {log.rows[first]} (header not counted) has {quantity} that is {fault}, as have "
                f"{n_invalid} of {count} rows: check how that column was written"
            )
        columns[quantity] = column
        is_kept &= is_valid
        spoilt.setdefault((fault, is_valid.tobytes()), []).append(quantity)
    for (fault, valid_bytes), quantities in spoilt.items():
        rows = log.rows[~np.frombuffer(valid_bytes, dtype=np.bool_)]
        log.notes.append(note_rows(NoteKind.SPOILT, rows, *quantities, text=fault))
    if np.count_nonzero(is_kept) < min(fewest, count):
        raise RecordingError(
            f"fewer than {fewest} rows have all of time, position and torque: write them in the same rows"
        )
    log.values = columns
    log.keep_rows(is_kept)


def keep_shared_rows(logs: Sequence[Log], fewest: int) -> None:
    """Remove rows that another of the logs of one file lacks; refuse fewer than `fewest` rows."""
    shared = logs[0].rows
    for log in logs[1:]:
        shared = np.intersect1d(shared, log.rows)
    if len(shared) < fewest and any(len(log.rows) >= fewest for log in logs):
        raise RecordingError(
            f"only {len(shared)} rows have numbers of all joints: sample all joints at once, and write them in the "
            "same rows"
        )
    for log in logs:
        if len(log.rows) > len(shared):
            log.keep_rows(np.isin(log.rows, shared))


def shift_restarted_runs(log: Log) -> None:
    """Shift the time of a new `segment` whose clock was set back; the gap is `CLEANING.restart_gap`."""
    if "segment" in log.values:
        time = log.values["time"]
        steps = np.diff(time)
        is_restart = (np.diff(log.values["segment"]) != 0) & (steps <= 0)
        shift = np.append(0.0, np.cumsum(np.where(is_restart, CLEANING.restart_gap - steps, 0.0)))
        log.values = {**log.values, "time": time + shift}


def has_repeated_times(log: Log) -> bool:
    """Return whether rows that repeat a time have new positions as often as other rows: they are no copies."""
    steps, is_moved = np.diff(log.values["time"]), np.diff(log.values["position"]) != 0
    is_repeat = steps <= CLEANING.repeated_step * np.median(steps)
    if steps.min() < 0 or not is_repeat.any() or is_repeat.all():
        return False
    return bool(is_moved[is_repeat].mean() > CLEANING.least_moved * is_moved[~is_repeat].mean())


def drop_repeated_times(log: Log) -> None:
    """Remove rows whose time repeats that of the previous row."""
    time = log.values["time"]
    steps = np.diff(time)
    if steps.min() < 0:
        first = int(np.argmax(steps < 0))
        raise RecordingError(
            f"time falls from {time[first]:.15g} to {time[first + 1]:.15g} s at data row {log.rows[first + 1]} "
            "(header not counted): sort the rows, or name a column segment that counts the runs"
        )
    is_new = np.append(True, steps > CLEANING.repeated_step * np.median(steps))
    if np.count_nonzero(is_new) < 2:
        raise RecordingError(f"time is {time[0]:.15g} s in every row: write it with more decimals")
    position = log.values["position"]
    within, between = np.abs(np.diff(position))[~is_new[1:]], np.abs(np.diff(position[is_new]))
    if len(within) > len(time) / 3 and np.median(within) > 2 * np.median(between):  # else the clock is coarse
        raise RecordingError(
            f"most times stand in several rows with different positions, as at data row {log.rows[np.argmin(is_new)]} "
            "(header not counted): the rows are of several joints or topics, keep those of one"
        )
    if 2 * np.count_nonzero(is_new) < len(time) and has_repeated_times(log):
        raise RecordingError(
            f"{len(time)} rows with different positions have only {np.count_nonzero(is_new)} different times, as at "
            f"data row {log.rows[np.argmin(is_new)]} (header not counted): write time with more decimals"
        )
    if not is_new.all():
        log.notes.append(note_rows(NoteKind.TIME_REPEATED, log.rows[~is_new]))
        log.keep_rows(is_new)


def drop_initial_holds(log: Log) -> None:
    """Remove the samples of free swings before their release, at which the joint is held away from equilibrium.

    Each part of the log, between gaps of `CLEANING.restart_gap` or of another `segment`, is a swing of its own. The
    median of position is the equilibrium. If position is the integral of a velocity, each part has its own equilibrium,
    and the mean velocity at rest is subtracted: it is the offset of the sensor, such as a gyroscope.
    """
    time, position = log.values["time"] - log.values["time"][0], log.position
    is_new = (np.diff(time) >= CLEANING.restart_gap) | (np.diff(log.values.get("segment", np.zeros(len(time)))) != 0)
    is_kept, offsets, equilibrium = np.ones(len(time), dtype=np.bool_), np.zeros(len(time)), float(np.median(position))
    for rows in np.split(np.arange(len(time)), np.flatnonzero(is_new) + 1):
        own_time = time[rows] - time[rows[0]]
        equilibrium = float(np.median(position[rows])) if log.is_integral else equilibrium
        begin, release = _find_hold(own_time, position[rows], equilibrium)
        if release:
            until = Quantity(float(time[rows[0]]) + release, unit="s")
            log.notes.append(Note(NoteKind.HELD_AT_FIRST, ("position",), {"time": until}))
            is_kept[rows] = own_time >= release
            is_held = np.abs(own_time - 0.5 * (begin + release)) <= 0.5 * CLEANING.rest_share * (release - begin)
            if log.is_integral and (offset := _measure_offset(log.values["velocity"][rows], is_held)):
                offsets[rows] = offset
                log.notes.append(Note(NoteKind.OFFSET, ("velocity",), {"offset": Quantity(offset, unit="rad/s")}))
    if offsets.any():
        log.replace_series(velocity=log.values["velocity"] - offsets)
    log.keep_rows(is_kept)


def _measure_offset(velocity: Array, is_held: Mask) -> float:
    """Return the mean velocity (N,) [rad/s] of a joint at rest: while it is held, and after the end of its motion."""
    mean, std = np.mean(velocity[is_held]), np.std(velocity[is_held])
    is_moving = np.abs(velocity - mean) > CLEANING.rest_ratio * std
    has_stopped = np.logical_and.accumulate(~is_moving[::-1])[::-1]
    return float(np.mean(velocity[is_held | has_stopped]))


def _find_hold(time: Array, position: Array, equilibrium: float) -> tuple[float, float]:
    """Return when a joint (N,) begins to be held away from its equilibrium [rad], and its release; 0, 0 without a hold.

    A joint that begins at its equilibrium is raised first, to its largest angle. After the release, position moves by
    a t^2 / 2: the time of the release follows from the times of the displacements d and 9 d. It moves by
    tan(e) (cosh(w t) - 1) if it falls from an angle e from upright.
    """
    tilts, span = np.abs(position - equilibrium), float(np.ptp(position))
    if np.cos(tilts[0]) > np.cos(CLEANING.least_tilt):
        is_below = tilts[: np.argmax(tilts) + 1] < CLEANING.held_share * tilts.max()
        begin = len(is_below) - int(np.argmax(is_below[::-1]))
        time, position = time[begin:], position[begin:]
    tilt = float(position[0] - equilibrium) if len(position) else 0.0
    if np.cos(tilt) > np.cos(CLEANING.least_tilt) or span == 0.0:
        return 0.0, 0.0
    travel = np.abs(position - np.median(position[: max(3, len(position) // 500)])) / span
    shares = np.array([0.01, 0.09])
    if not (travel > shares[1]).any():
        return 0.0, 0.0
    near, far = (float(time[np.argmax(travel > share)]) for share in shares)
    times = np.arccosh(1 + shares * span / abs(np.tan(tilt))) if np.cos(tilt) < 0 else np.sqrt(shares)
    release = float((times[1] * near - times[0] * far) / (times[1] - times[0]))
    is_held = release - time[0] > max(CLEANING.longest_hold, far - release) / 2
    return (float(time[0]), release) if is_held else (0.0, 0.0)


def start_from_zero(log: Log) -> None:
    """Count time from the first sample; store start, resolution and rounding of the original time."""
    time = log.values["time"]
    log.start, log.resolution = float(time[0]), find_resolution(time)
    log.rounding = 4.0 * float(np.spacing(np.abs(time).max()))
    log.values = {**log.values, "time": time - time[0]}


def drop_spoilt_positions(log: Log) -> None:
    """Remove rows with an impossible position.

    Glitches are single samples far from both neighbours. Stale values repeat the last one, and are followed by an
    impossible jump or by a jump to the position of steady motion.
    """
    position, steps = log.position, np.diff(log.values["time"])
    typical_bend = estimate_bend(position)
    # steps across which the joint may go anywhere: long ones, and those to another segment
    cuts = steps > CLEANING.long_step * np.median(steps)
    cuts |= np.diff(log.values.get("segment", np.zeros(len(position)))) != 0
    is_kept = np.ones(len(position), dtype=np.bool_)
    for kind, samples in (
        (NoteKind.GLITCHES, _find_glitches(position, typical_bend)),
        (NoteKind.STALE, _find_stale_samples(position, typical_bend, cuts)),
    ):
        if len(samples):
            log.notes.append(note_rows(kind, log.rows[samples], "position"))
            is_kept[samples] = False
    log.keep_rows(is_kept)


def find_turns(values: Mapping[str, Array], columns: Mapping[str, FileColumn]) -> dict[str, float]:
    """Find the turn at which position and reference may be wrapped [rad].

    It is a turn of the encoder, for example 2 pi / 8 before a gear of 8, if 99.9 % of the positions lie within it. Else
    it is 2 pi, as an encoder that counts turns may move by more than half a turn between samples.
    """
    turns = {"position": TURN, "reference": TURN}
    for quantity in turns:
        if quantity not in columns or (turn := columns[quantity].turn) == TURN:
            break
        finite = values[quantity][np.isfinite(values[quantity])]
        if not len(finite) or np.ptp(np.quantile(finite, [5e-4, 1 - 5e-4])) > WRAPPED_RANGE * turn:
            break
        turns[quantity] = turn
    return turns


def unwrap_positions(log: Log, is_angle: bool) -> int:
    """Undo jumps of a turn in position, and in a reference that `is_angle`; return the number of jumps.

    Raises RecordingError if an encoder before a gear may be on another turn after a gap.
    """
    position, turn = log.values["position"], log.turns["position"]
    jumps = int(np.count_nonzero(np.abs(np.diff(position)) > turn / 2))
    if jumps and turn < TURN and len(log.starts) > 1:
        raise RecordingError(
            f"position wraps at {turn:.4g} rad, a turn of its encoder, and the log has a gap at data row "
            f"{log.rows[log.starts[1]]} (header not counted), after which the turn is unknown: make a file of each part"
        )
    log.values = {**log.values, "position": log.position}
    if "reference" in log.values and is_angle:
        references, turn_of_reference = log.values["reference"], log.turns["reference"]
        log.values["reference"] = _unwrap_reference(references, log.values["position"], turn_of_reference, jumps)
    if jumps:
        numbers = {"count": Quantity(jumps), "turn": Quantity(turn, unit="rad")}
        log.notes.append(Note(NoteKind.UNWRAPPED, ("position",), numbers))
    return jumps


def _unwrap_reference(reference: Array, position: Array, turn: float, jumps: int) -> Array:
    """Put a reference (N,) on the turns of the unwrapped position (N,), which had `jumps`.

    An error of control may exceed half a turn of an encoder before a gear. There the reference is unwrapped alone, in
    parts between its steps. Each part is moved by whole turns until its median is nearest to position.
    """
    if turn == TURN:
        return reference + turn * np.round((position - reference) / turn)
    if not jumps:
        return reference
    reference = np.unwrap(reference, period=turn)
    steps = np.flatnonzero(np.abs(np.diff(reference)) > REFERENCE_STEP * turn) + 1
    parts = zip(np.split(reference, steps), np.split(position, steps), strict=True)
    return np.concatenate([part + turn * np.round(np.median(measured - part) / turn) for part, measured in parts])


def note_rows(kind: NoteKind, rows: Index, *quantities: str, text: str = "") -> Note:
    """Make a note of rows of the file."""
    return Note(kind, quantities, {"count": Quantity(len(rows))}, places=tuple(rows[:NAMED].tolist()), text=text)


def estimate_bend(position: Array) -> float:
    """Return the 99th percentile of the distances of positions (N,) from the mean of their neighbours [rad].

    Positions beside a repeated one do not count, unless all are: a stale value makes three large distances. If the
    result is 0, return the smallest step of the encoder, or 0 without motion.
    """
    if len(position) < 3:
        return 0.0
    bends = np.abs(position[1:-1] - 0.5 * (position[:-2] + position[2:]))
    moves = np.abs(np.diff(position))
    is_near_repeated = np.convolve(moves == 0, np.ones(3), "same") > 0
    is_free = ~(is_near_repeated[:-1] | is_near_repeated[1:])
    bends = bends[is_free] if is_free.any() else bends
    return float(np.quantile(bends, 0.99) or (moves[moves > 0].min() if moves.any() else 0.0))


def _find_glitches(q: Array, typical_bend: float) -> Index:
    """Return the samples of q (N,) that are far from the mean of smooth neighbours."""
    if len(q) < 5:
        return np.empty(0, dtype=np.intp)
    bends = np.abs(q[2:-2] - 0.5 * (q[1:-3] + q[3:-1]))
    k = np.flatnonzero(bends > CLEANING.glitch_ratio * typical_bend)
    neighbour_steps = np.abs(np.diff([q[k], q[k + 1], q[k + 3], q[k + 4]], axis=0)).max(axis=0)  # without it
    return k[bends[k] > CLEANING.glitch_ratio * neighbour_steps] + 2


def _find_stale_samples(q: Array, typical_bend: float, cuts: Mask) -> Index:
    """Return the samples of q (N,) that repeat the last one although the joint moves on, not before cuts (N - 1,).

    Runs of at most `short_run` values are also stale if the motion without them is smoother, see `_is_smoother`. A
    joint that moves before or after a stand-still, and jumps at its end, did not rest. The jump is compared with the
    bends of motion alone, not of rest. Jumps of more than half a turn are left to `refuse_jumps`, since a wrapped angle
    has them. If the step to the repeated value is a jump, too, the first sample of the run is also invalid.
    """
    steps = np.diff(q)
    is_still = steps == 0
    edges = np.flatnonzero(np.diff(is_still, prepend=False, append=False))
    first, end = edges[::2], edges[1::2]  # steps of runs without motion
    is_inner = (first > 0) & (end < len(steps) - 1)
    first, end = first[is_inner], end[is_inner]
    if not len(first):
        return np.empty(0, dtype=np.intp)
    before, jump, after = steps[first - 1], steps[end], steps[end + 1]
    count = np.min(np.abs(steps), where=np.abs(steps) > ROUNDING * np.ptp(q), initial=np.inf)  # of the encoder
    steady, filled = 0.5 * (before + after), jump / (end - first + 1)
    tolerance = CLEANING.steady_tolerance * np.abs(steady)
    is_stale = (np.abs(steady) >= CLEANING.moving_ratio * typical_bend) & (np.abs(before - after) <= 2 * tolerance)
    is_stale &= np.abs(filled - steady) <= tolerance
    is_short = (end - first <= CLEANING.short_run) & (np.abs(filled) > CLEANING.least_counts * count)
    is_short &= np.mean(after == 0) < CLEANING.slow_encoder
    is_stale |= is_short & _is_smoother(before, filled, jump, after)
    bends = 0.5 * np.abs(np.diff(steps))[~(is_still[1:] & is_still[:-1])]
    typical_bend = max(typical_bend, float(np.quantile(bends, 0.99)))
    is_jump_before = _is_impossible(before, steps[first - 2], typical_bend) & (first > 1)
    is_jump = _is_impossible(jump, after, typical_bend) & (end - first > 1) & ~cuts[end]
    is_moving = _is_moving(q, first - is_jump_before, -1, typical_bend) | _is_moving(q, end + 1, 1, typical_bend)
    is_stale |= is_jump & is_moving
    begin = np.where(is_jump_before & is_jump, first, first + 1)
    runs = [np.arange(a, b + 1) for a, b in zip(begin[is_stale], end[is_stale], strict=True)]
    return np.concatenate([np.empty(0, dtype=np.intp), *runs])


def _is_smoother(before: Array, filled: Array, jump: Array, after: Array) -> Mask:
    """Return whether equal steps `filled` make the steps around repeated values (M,) smoother by `smooth_ratio`."""
    with_repeated = np.abs(before) + np.abs(jump) + np.abs(after - jump)
    return with_repeated > CLEANING.smooth_ratio * (np.abs(filled - before) + np.abs(after - filled))


def _is_impossible(jump: Array, neighbour_step: Array, typical_bend: float) -> Mask:
    """Return whether jumps (M,) exceed their neighbour steps (M,) and the usual bend, within half a turn."""
    threshold = np.maximum(CLEANING.glitch_ratio * typical_bend, CLEANING.jump_ratio * np.abs(neighbour_step))
    return (np.abs(jump) > threshold) & (np.abs(jump) <= TURN / 2)


def _is_moving(q: Array, samples: Index, direction: int, typical_bend: float) -> Mask:
    """Return whether the joint moves before samples of q (M,), or after them for direction 1 instead of -1.

    The travel over `TRAVEL_ROWS` rows is compared with the next as many: a joint that comes to rest travels ever less.
    """
    places = (samples + direction * k * TRAVEL_ROWS for k in (0, 1, 2))
    travel, next_travel = np.diff([q[np.clip(place, 0, len(q) - 1)] for place in places], axis=0)
    near, far = np.abs(travel), np.abs(next_travel)
    is_steady = (2 * near > far) & (CLEANING.jump_ratio * far > near) & (travel * next_travel > 0)
    return is_steady & (near > CLEANING.moving_ratio * typical_bend)
