"""Refuse implausible and unusable recordings.

A check takes columns in SI units, and raises a RecordingError or returns None or notes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pendulum_env._typing import Array, Index
from pendulum_env.errors import ColumnError, MotionlessError, RecordingError
from pendulum_env.recording.angle_unit import suspect_radians, suspect_unit
from pendulum_env.recording.cleaning import WRAPPED_RANGE
from pendulum_env.recording.clock import STEPS, list_plausible_units
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.expression import Expression
from pendulum_env.recording.notes import Note
from pendulum_env.recording.origin import Origin
from pendulum_env.recording.record import Recording
from pendulum_env.recording.vocabulary import UNITS, UNKNOWN_UNIT
from pendulum_env.settings import format_setting


@dataclass(frozen=True)
class Bounds:
    """Plausible limits of recordings of a pendulum."""

    shortest: float = 1.0  # [s]; about one swing of a pendulum of 0.3 m
    fewest: int = 100  # samples
    slowest: float = 10.0  # [Hz]; a pendulum swings at about 1 Hz
    fastest: float = 500.0  # [rad/s], of a bare motor; a pendulum without a gear reaches some 40
    window: float = 0.02  # [s] over which speeds are taken: longer than encoder steps, shorter than a swing
    largest_current: float = 200.0  # [A], of the motor of a joint
    least_constant: float = 0.01  # [N m/A], least torque constant at a joint
    counter_values: int = 50  # different torques, from which whole numbers alone are those of a counter
    reference_distance: float = 6 * np.pi  # [rad] by which a position may stay away from its reference
    zero_current: float = 0.02  # of the largest: a current below it counts as zero
    zero_share: float = 0.01  # least share of zeros of a current without sign
    reversed_share: float = 0.1  # least ratio of the rows with one direction of motion to those with the other
    equal_correlation: float = 0.95  # correlation of two torques beyond which they may be one


BOUNDS = Bounds()
VELOCITY_FACTORS = (  # ratio of the slope of position to velocity, if one has another unit
    ("position", "deg", 180 / np.pi),
    ("velocity", "deg/s", np.pi / 180),
    ("velocity", "rev/s", 2 * np.pi),
    ("velocity", "rpm", 2 * np.pi / 60),
)


def _format_columns(columns: Mapping[str, str]) -> str:
    """Format the option `columns` for a message."""
    return format_setting("columns", columns)


def refuse_large_current(values: Array, origin: Origin) -> None:
    """Refuse a current whose unit A is only a guess and whose values are too large for a joint's motor.

    First gains below `BOUNDS.constant` are no torque constant of a joint: they convert counts to a current or a torque.
    """
    column = origin.columns["torque"]
    largest = float(np.nanquantile(np.abs(values), 0.99)) if np.isfinite(values).any() else 0.0
    factors = column.expression.factors
    gains = [abs(Expression("", factors=factors[:k]).gain) for k in range(1, len(factors) + 1)]
    largest *= next((gain for gain in gains if gain < BOUNDS.least_constant), 1.0)
    if column.is_current_by_guess and largest > BOUNDS.largest_current:
        raise ColumnError(
            f"the current of column {column.header!r} reaches {largest:.4g}, too much in A: read it with "
            f"{_format_columns(origin.change_column('torque', unit='mA'))} if it is in mA, or give the unit in the "
            "name of the column"
        )


def refuse_torque_counts(values: Array, origin: Origin) -> None:
    """Refuse a torque of many whole numbers without a unit: amplifiers log per mille of a rated torque, or mN m."""
    column, finite = origin.columns["torque"], values[np.isfinite(values)]
    if column.has_unit or column.expression.name or (finite != np.round(finite)).any():
        return
    if len(np.unique(finite)) > BOUNDS.counter_values:
        options = [
            _format_columns(origin.change_column("torque", **change))
            for change in ({"unit": "Nm"}, {"unit": "mNm"}, {"factors": ("*0.001",)})
        ]
        raise ColumnError(
            f"torque has whole numbers alone, as a drive counts it: read column {column.header!r} with {options[0]} "
            f"or {options[1]}, or {options[2]} with the torque of a count [N m]"
        )


def refuse_unknown_unit(origin: Origin) -> None:
    """Refuse a position whose dataset does not tell the unit, and whose values do not either."""
    column = origin.columns["position"]
    if column.header.endswith(UNKNOWN_UNIT) and not column.has_unit:
        options = [_format_columns(origin.change_column("position", unit=unit)) for unit in ("rad", "deg")]
        raise ColumnError(f"the unit of column {column.header!r} is unclear: read it with {options[0]} or {options[1]}")


def is_without_sign(column: FileColumn, current: Array, position: Array) -> bool:
    """Return whether a current (N,) lacks its sign: it falls to zero, never below, but drives the joint to and fro.

    Most rows of either direction of motion have current. Other motion is free, or due to the weight alone.
    """
    if not column.is_raw:
        return False
    is_known = np.isfinite(current) & np.isfinite(position)
    current, travel = current[is_known], np.diff(position[is_known], prepend=position[is_known][:1])
    is_zero = current <= BOUNDS.zero_current * current.max(initial=0.0)
    if current.min(initial=0.0) < 0 or np.count_nonzero(is_zero) <= BOUNDS.zero_share * len(current):
        return False
    ways = [~is_zero[travel > 0], ~is_zero[travel < 0]]
    counts = sorted(map(np.count_nonzero, ways))
    is_driven = all(2 * np.count_nonzero(way) > len(way) for way in ways)
    return bool(is_driven and counts[0] > BOUNDS.reversed_share * counts[1])


def refuse_torque_of_motor_off(torque: Array, enabled: Array, origin: Origin) -> None:
    """Refuse a motor that is off in every row of a log with changing torque: 0 may mean on, or was never filled in."""
    if not enabled.any() and np.ptp(torque) > 0:
        on, off = (_format_columns(origin.omit_column(quantity)) for quantity in ("enabled", "torque"))
        raise ColumnError(
            f"column {origin.columns['enabled'].header!r} says that the motor is off in every row, but torque changes: "
            f"read it with {on} if the motor was on, or {off} if the joint swung freely"
        )


def refuse_too_few(time: Array) -> None:
    """Refuse too few samples for an estimate."""
    if len(time) < BOUNDS.fewest:
        raise RecordingError(
            f"it holds {len(time)} samples, of which at least {BOUNDS.fewest} are needed: record longer"
        )


def refuse_implausible(recording: Recording, origin: Origin) -> None:
    """Refuse a recording that is too short, or whose reference, load torque or velocity contradicts its motion."""
    refuse_too_short(recording, origin)
    refuse_foreign_reference(recording, origin)
    refuse_doubled_torque(recording, origin)
    if recording.velocity is not None:
        refuse_foreign_velocity(recording, origin)


def refuse_too_short(recording: Recording, origin: Origin) -> None:
    """Refuse too low sample rates and too short recordings; suggest another unit of time."""
    period, duration = 1 / recording.rate, recording.duration
    if period > 1 / BOUNDS.slowest:
        raise ColumnError(
            f"{period:.3g} s pass between samples, too long for a pendulum ({BOUNDS.slowest:g} Hz is the least): "
            f"{_suggest_time_unit(period, origin)}sample faster"
        )
    if duration + period < 0.99 * BOUNDS.shortest:
        hint = _suggest_time_unit(period, origin) if period < STEPS[0] else ""
        raise RecordingError(
            f"it lasts {duration:.3g} s, of which at least {BOUNDS.shortest:g} s are needed: {hint}record longer"
        )


def _suggest_time_unit(period: float, origin: Origin) -> str:
    """Suggest a unit of time in which the sample time, read as `period` [s], is plausible."""
    units = list_plausible_units(period / origin.columns["time"].scale)
    hints = [
        f"read it with {_format_columns(origin.change_column('time', unit=unit))} if time is in {unit}, or "
        for unit in units
    ]
    return "".join(hints[:1])


def refuse_motionless(position: Array) -> None:
    """Refuse a position that never changes."""
    if (position == position[0]).all():
        raise MotionlessError(
            f"position is {position[0]:.6g} rad in every row, so nothing can be learned: check the encoder, "
            "or record the joint in motion"
        )


def refuse_jumps(
    position: Array, rows: Index, starts: Sequence[int], origin: Origin, *, turn: float, allow_wrapped: bool
) -> None:
    """Refuse positions that jump by more than half a turn [rad] between samples: wrapped, or not an angle.

    A joint with many turns may move by more: its jumps are the differences from the median of five steps.
    """
    steps = np.diff(position)
    steps[[start - 1 for start in starts[1:]]] = 0.0  # gaps are no jumps
    jumps = np.abs(steps)
    is_wrapped = bool(np.ptp(position) < WRAPPED_RANGE * turn or abs(jumps.max() - turn) < 0.08 * turn)
    if not is_wrapped:
        jumps = np.abs(steps - scipy.ndimage.median_filter(steps, 5, mode="nearest"))
    size = float(jumps.max())
    if size <= np.pi and not (is_wrapped and size > turn / 2):
        return
    row = rows[int(np.argmax(jumps > size / 2)) + 1]
    jump_text = f"position jumps by {size:.4g} rad from one sample to the next at data row {row} (header not counted)"
    if is_wrapped:
        if not allow_wrapped:
            period_text = "2 pi" if turn == 2 * np.pi else "a turn of its encoder"
            raise RecordingError(
                f"{jump_text}, as an angle wrapped at {period_text} does: read it with {format_setting('unwrap', True)}"
            )
    elif 270 < size < 361:
        raise ColumnError(
            f"{jump_text}, as an angle wrapped at 360 degrees does: read it with {format_setting('unwrap', True)}, and "
            f"with {_format_columns(origin.change_column('position', unit='deg'))}"
        )
    elif abs(size / float(np.ptp(position)) - 1) < 0.05 and (counter := origin.change_to_counter(size)) is not None:
        raise ColumnError(
            f"{jump_text}, as a counter of several turns that starts again does: read it with "
            f"{format_setting('unwrap', True)}, and with {_format_columns(counter)}"
        )
    else:
        raise ColumnError(
            f"{jump_text}: {_suggest_position_unit(origin, confirms=False)}, or repair the glitch if it is one"
        )


def refuse_too_fast(recording: Recording, origin: Origin) -> None:
    """Refuse impossible speeds."""
    rate, span = recording.rate, max(1, round(BOUNDS.window * recording.rate))
    for part in recording.segments:
        if len(part) <= span:
            continue
        speed = np.abs(part.position[span:] - part.position[:-span]) * (rate / span)  # [rad/s]
        if (top := float(speed.max())) > BOUNDS.fastest:
            raise ColumnError(
                f"position moves at {top:.0f} rad/s near {part.time[int(np.argmax(speed))]:.6g} s, faster "
                f"than any joint: {_suggest_position_unit(origin)}"
            )


def check_unit(recording: Recording, origin: Origin) -> tuple[Note, ...]:
    """Refuse an angle in another unit than it was read in; return a note if the unit is uncertain.

    Turns are tested only with logged torque, because the torque computed from a controller is too inexact.
    """
    part, column = max(recording.segments, key=len), origin.columns["position"]
    if column.unit in UNITS["position"] and abs(column.scale) != 1.0 and not column.expression.factors:
        radians = suspect_radians(part.position, part.torque, part.rate, 1.0 / abs(column.scale))
        if radians is not None:
            advice = _format_columns(origin.change_column("position", unit=radians.unit))
            raise ColumnError(f"{radians.text}: read it with {advice} if it is in radians")
    if not origin.can_be_degrees():
        return ()
    is_guess = origin.columns["position"].unit is None
    suspicion = suspect_unit(part.position, part.torque, part.rate, turns=is_guess and recording.has_logged_torque)
    if suspicion is None:
        return ()
    if not suspicion.is_certain:
        return (suspicion.note(origin.change_column("position", unit=suspicion.unit)),)
    raise ColumnError(f"{suspicion.text}: {_suggest_position_unit(origin, suspicion.unit)}")


def _suggest_position_unit(origin: Origin, unit: str = "deg", *, confirms: bool = True) -> str:
    """Suggest another unit of position, and the option that confirms a guessed one."""
    if not origin.can_be_degrees():
        advice = "check its unit and gain"
    elif origin.are_counts:
        advice = f"read it with {_format_columns(origin.change_to_counts())} if an encoder counts 4096 to a turn"
    else:
        name = {"deg": "degrees", "rev": "turns"}[unit]
        advice = f"read it with {_format_columns(origin.change_column('position', unit=unit))} if it is in {name}"
    if not confirms or origin.columns["position"].has_unit:
        return advice
    return f"{advice}, with {_format_columns(origin.change_column('position', unit='rad'))} if it is not"


def refuse_foreign_reference(recording: Recording, origin: Origin) -> None:
    """Refuse a reference that is turns away from the position, due to another unit or zero."""
    if (reference := recording.goal) is None:
        return
    distance = float(np.median(np.abs(reference - recording.position)))
    if distance > BOUNDS.reference_distance:
        raise ColumnError(
            f"the goal is {distance:.3g} rad away from the position, as if in another unit or from another zero: give "
            f"it the unit and zero of the position, {_format_columns(origin.change_column('reference', unit='deg'))} "
            "for one"
        )


def refuse_doubled_torque(recording: Recording, origin: Origin) -> None:
    """Refuse an unnamed load torque that is correlated with the torque: it may be a sensor of the motor torque.

    Otherwise the motor torque would count twice.
    """
    if recording.load_torque is None or "load_torque" in origin.named_columns:
        return
    is_moving = np.gradient(recording.position) != 0
    pair = np.array([recording.torque[is_moving], recording.load_torque[is_moving]])
    if is_moving.sum() < 2 or not np.ptp(pair, axis=1).all():
        return
    if (correlation := float(np.corrcoef(pair)[0, 1])) > BOUNDS.equal_correlation:
        raise ColumnError(
            f"load_torque, from column {origin.columns['load_torque'].header!r}, follows torque ({correlation:.3f} "
            "correlated), and both would add up: read it with "
            f"{_format_columns(origin.omit_column('load_torque'))} if it "
            f"measures the torque of the motor, with {_format_columns(origin.change_column('load_torque'))} "
            "if another machine "
            "applies it"
        )


def refuse_foreign_velocity(recording: Recording, origin: Origin) -> None:
    """Refuse a velocity that is not the slope of position, due to another unit, sign or signal."""
    pairs = [
        _compute_motions(part.rate, part.position, part.velocity)
        for part in recording.segments
        if part.velocity is not None
    ]
    slope, expected = (np.concatenate(series) for series in zip(*pairs, strict=True))  # [rad]
    remedy = f"mend it, or do without it, which is optional: {_format_columns(origin.omit_column('velocity'))}"
    size = float(np.linalg.norm(slope) * np.linalg.norm(expected))
    correlation = float(slope @ expected / size) if size else 0.0
    if abs(correlation) < 0.5:
        if np.ptp(recording.position) > 0.2:  # [rad]; above encoder steps
            raise ColumnError(
                f"velocity does not follow the slope of position ({correlation:.2f} correlated): {remedy}"
            )
        return
    ratio = float(correlation * np.linalg.norm(slope) / np.linalg.norm(expected))
    if gear := origin.apply_gear("velocity", ratio):
        raise ColumnError(
            f"velocity is {1 / ratio:.3g} times the slope of position, as if it lacked a ratio of position: read it "
            f"with {_format_columns(gear)}"
        )
    if correlation < 0:
        columns = _format_columns(origin.flip_sign("velocity") or {})
        raise ColumnError(f"velocity has the opposite sign of the slope of position: read it with {columns}")
    for quantity, unit, factor in VELOCITY_FACTORS:
        if 0.9 < ratio / factor < 1.1 or (unit[:3] == "deg" and 0.7 < ratio / factor < 1.4):
            raise ColumnError(
                f"velocity is {1 / ratio:.3g} times the slope of position, as if {quantity} were in {unit}: read it "
                f"with {_format_columns(origin.change_column(quantity, unit=unit))}"
            )
    if not 0.5 < ratio < 2:
        raise ColumnError(f"velocity is {1 / ratio:.3g} times the slope of position: {remedy}")


def _compute_motions(rate: float, position: Array, velocity: Array) -> tuple[Array, Array]:
    """Return the motion in each `BOUNDS.window` from position and from velocity, (M,) each [rad]."""
    span = max(1, round(BOUNDS.window * rate))
    count = (len(position) - 1) // span
    mean = (velocity[:-1] + velocity[1:]) / 2
    expected = mean[: count * span].reshape(count, span).sum(axis=1) / rate
    return np.diff(position[: count * span + 1 : span]), expected
