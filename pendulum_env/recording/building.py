"""Build the recordings of the joints of a file: in SI units, cleaned, and in segments of one uniform time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from pendulum_env._typing import JSON, Array
from pendulum_env.errors import ColumnError
from pendulum_env.quantity import Quantity
from pendulum_env.recording import checks, cleaning, jitter, sampling
from pendulum_env.recording.actuator import MOTOR, Actuator
from pendulum_env.recording.clock import find_date, find_unix_unit, unwrap_clock
from pendulum_env.recording.columns import NONE, FileColumn
from pendulum_env.recording.joint_names import name_errors
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.origin import Origin
from pendulum_env.recording.record import NO_TORQUE, Recording, complete_torque
from pendulum_env.recording.rounding import count_significant_digits, find_least_change
from pendulum_env.recording.table import RawTable
from pendulum_env.settings import format_setting


@dataclass
class JointLog:
    """Log of one joint of a file during the construction of its recording.

    Attributes:
        joint: name of the joint; empty if the file has one.
        log: content of the file.
        origin: its columns.
        unit: of its torque.
        date: of the first row; None if unknown.
    """

    joint: str
    log: cleaning.Log
    origin: Origin
    unit: str
    date: datetime | None


def build_recordings(
    name: str,
    tables: Mapping[str, RawTable],
    unwrap: bool,
    controller: Actuator | None,
    named_columns: Mapping[str, Mapping[str, str]],
    log_format: JSON,
    has_gravity: bool = True,
) -> dict[str, Recording]:
    """Convert the tables of the joints of a file to recordings with the same instants; refuse implausible data.

    Values are converted to SI units and cleaned joint by joint. Rows that are left out of one joint are left out of
    all. Stamps, lost rows, gaps and the period of the clock are decided once, by the motion of all joints.

    Args:
        name: name of the recordings.
        tables: of the columns of each joint, by its name; the name of a single joint may be empty.
        unwrap: whether jumps of a turn in position are undone.
        controller: of the joint; None without one.
        named_columns: columns that the user named, by joint and quantity.
        log_format: reading options of the file.
        has_gravity: whether gravity may act on the joints.
    """
    joints, actuator = list[JointLog](), controller or MOTOR
    for joint, table in tables.items():
        with name_errors(joint):
            joints.append(_open_log(joint, table, unwrap, actuator.select_joint(joint), named_columns[joint]))
    _clean_rows(joints, can_swing=not actuator.is_controller)
    jumps = dict.fromkeys(tables, 0)
    for item in joints:
        log, turn = item.log, item.log.turns["position"]
        with name_errors(item.joint):
            position = log.values["position"]
            if not item.origin.has_integral:
                checks.refuse_jumps(position, log.rows, log.starts, item.origin, turn=turn, allow_wrapped=unwrap)
                if unwrap:
                    is_angle = not actuator.select_joint(item.joint).acts_on_speed
                    jumps[item.joint] = cleaning.unwrap_positions(log, is_angle=is_angle)
            sampling.drop_short_segments(log)
    sampling.resample_uniformly([item.log for item in joints])
    assert all(np.array_equal(item.log.values["time"], joints[0].log.values["time"]) for item in joints)
    recordings = dict[str, Recording]()
    for item in joints:
        with name_errors(item.joint):
            recording = _make_recording(item, name, controller and controller.select_joint(item.joint), log_format)
            if not jumps[item.joint]:  # jumps of 2 pi confirm the unit
                recording = replace(
                    recording, notes=(*recording.notes, *_find_doubts(recording, item.origin, has_gravity))
                )
            recordings[item.joint] = recording
    return recordings


def _open_log(
    joint: str, table: RawTable, unwrap: bool, actuator: Actuator, named_columns: Mapping[str, str]
) -> JointLog:
    """Convert a table to SI units, with notes on its columns; refuse implausible columns."""
    values = table.values
    columns, notes = _read_clock(table)
    if named_columns.get("torque") == NONE and "torque" in columns and columns["torque"].header != NONE:
        others = {name: text for name, text in named_columns.items() if name != "load_torque"}  # a load torque alone
        named_columns = {**others, "torque": named_columns.get("load_torque", columns["torque"].header)}
    if columns["position"].is_integral:
        values["position"] = _integrate_velocity(values, columns)
    if "torque" in values and checks.is_without_sign(columns["torque"], values["torque"], values["position"]):
        header = columns.pop("torque").header
        if not actuator.is_controller:
            raise ColumnError(
                f"column {header!r} is never negative while the motion reverses: a current without sign is no torque, "
                f"so leave it out with {format_setting('columns', {**named_columns, 'torque': NONE})}"
            )
        del values["torque"]
        notes.append(Note(NoteKind.UNSIGNED, ("torque",), headers=(header,)))
    digits, step = count_significant_digits(values["position"]), find_least_change(values["position"])
    columns["position"] = replace(columns["position"], digits=digits, step=step)
    origin = Origin(columns, named_columns, _are_counts(columns["position"], values["position"]))
    checks.refuse_unknown_unit(origin)
    _convert_to_si(values, origin)
    actuator.check_columns(values)
    unit = columns["torque"].result_unit if "torque" in columns else actuator.unit
    is_output = unit == actuator.logged_unit
    noted_columns = [column for column in columns.values() if not (is_output and column.quantity == "torque")]
    if "torque" not in values:
        values["torque"] = np.zeros_like(values["position"])  # with a controller, computed below
        if not actuator.is_controller:
            notes.append(Note(NoteKind.NO_TORQUE if "torque" in named_columns else NoteKind.NO_TORQUE_COLUMN))
    notes = [*(note for column in noted_columns for note in column.notes), *notes]
    turns, is_integral = cleaning.find_turns(values, columns), columns["position"].is_integral
    log = cleaning.Log(values, notes, turns=turns, unwraps=unwrap, is_integral=is_integral)
    return JointLog(joint, log, origin, unit, table.date)


def _make_recording(item: JointLog, name: str, controller: Actuator | None, log_format: JSON) -> Recording:
    """Make the recording of a joint of its cleaned log; refuse implausible values."""
    log, origin, date = item.log, item.origin, item.date
    if "enabled" in log.values:
        _round_enabled(log, origin)
    recording = Recording(
        name=name,
        **log.values,  # type: ignore[arg-type]
        notes=tuple(log.notes),
        starts=log.starts,
        torque_unit=item.unit,
        drive=controller,
        origin=origin,
        log_format=log_format,
        clock_start=log.start + (date.timestamp() if date else 0.0),
        start_date=find_date(log.start) or (date and date + timedelta(seconds=log.start)),
    )
    recording = complete_torque(recording.actuator, recording)
    checks.refuse_implausible(recording, origin)
    return recording


def _read_clock(table: RawTable) -> tuple[dict[str, FileColumn], list[Note]]:
    """Join whole seconds and their fraction, undo overflows, and find Unix time; return columns and notes."""
    columns, values, notes = dict(table.columns), table.values, list(table.notes)
    if fraction := columns.pop("fraction", None):
        part = values.pop("fraction") * fraction.scale
        is_part = bool(np.nanmax(np.abs(part), initial=0.0) <= 1.0)  # else the column is another clock
        values["time"] = values["time"] + part if is_part else values["time"]
        kind = NoteKind.TIME_OF_TWO if is_part else NoteKind.PASSED_OVER
        notes.append(Note(kind, ("time",), headers=(columns["time"].header, fraction.header)))
    clock = unwrap_clock(values["time"])
    notes += [Note(NoteKind.CLOCK_RESTARTED)] * (clock is not values["time"])
    values["time"] = clock
    if not columns["time"].has_unit and (unit := find_unix_unit(clock)) is not None:
        columns["time"] = replace(columns["time"], unit=unit)
    return columns, notes


def _integrate_velocity(values: Mapping[str, Array], columns: Mapping[str, FileColumn]) -> Array:
    """Return the integral of the velocity in SI units, by the trapezoidal rule; NaN without time or velocity."""
    time, velocity = (values[name] * columns[name].scale + columns[name].offset for name in ("time", "velocity"))
    position, is_known = np.full(len(time), np.nan), np.isfinite(time) & np.isfinite(velocity)
    position[is_known] = cleaning.integrate_velocity(time[is_known], velocity[is_known])
    return position


def _convert_to_si(values: dict[str, Array], origin: Origin) -> None:
    """Convert the columns to SI units in place; refuse implausible currents and counts of torque."""
    if "torque" in values:
        checks.refuse_large_current(values["torque"], origin)
        checks.refuse_torque_counts(values["torque"], origin)
    for quantity, column in origin.columns.items():
        with np.errstate(over="ignore", invalid="ignore"):  # overflows are treated as empty cells
            values[quantity] *= column.scale
            values[quantity] += column.offset


def _clean_rows(joints: Sequence[JointLog], *, can_swing: bool) -> None:
    """Remove invalid rows, correct time stamps, and cut the logs of all joints at gaps.

    The joint of a pendulum may have an encoder that is slower than its log. Without torque, its log that `can_swing`
    begins with the release.
    """
    logs, is_single = [item.log for item in joints], [item.joint for item in joints] == [""]
    for item in joints:
        with name_errors(item.joint):
            checks.refuse_too_few(item.log.values["time"])
            cleaning.fill_unchanged(item.log)
            cleaning.align_topics(item.log, checks.BOUNDS.fewest)
            cleaning.drop_invalid_rows(item.log, checks.BOUNDS.fewest)
    cleaning.keep_shared_rows(logs, checks.BOUNDS.fewest)
    for log in logs:
        cleaning.shift_restarted_runs(log)
    if any(cleaning.has_repeated_times(log) for log in logs):
        jitter.replace_late_stamps(logs)
    for item in joints:
        with name_errors(item.joint):
            cleaning.drop_repeated_times(item.log)
    first = logs[0]
    has_torque = (np.abs(first.values["torque"]) > NO_TORQUE).any()
    if is_single and can_swing and not has_torque and np.ptp(first.values["position"]) > 0:
        cleaning.drop_initial_holds(first)
    for log in logs:
        cleaning.start_from_zero(log)
    if is_single:
        jitter.resample_slow_encoder(first)
    for log in logs:
        cleaning.drop_spoilt_positions(log)
    cleaning.keep_shared_rows(logs, checks.BOUNDS.fewest)
    for item in joints:
        with name_errors(item.joint):
            checks.refuse_too_few(item.log.values["time"])
            if can_swing or is_single:  # a joint of several may hold its goal
                checks.refuse_motionless(item.log.values["position"])
    jitter.replace_late_stamps(logs)
    sampling.cut_at_gaps(logs)


def _round_enabled(log: cleaning.Log, origin: Origin) -> None:
    """Round the power switch to 0 or 1, and note the rows with the motor off; refuse an implausible switch."""
    log.values["enabled"] = np.asarray(log.values["enabled"] > 0.5, dtype=float)
    enabled = log.values["enabled"]
    checks.refuse_torque_of_motor_off(log.values["torque"], enabled, origin)
    if count := int(np.count_nonzero(enabled == 0)):
        numbers = {"count": Quantity(count), "rows": Quantity(len(enabled))}
        log.notes.append(Note(NoteKind.MOTOR_OFF, ("torque",), numbers, headers=(origin.columns["enabled"].header,)))


def _are_counts(column: FileColumn, values: Array) -> bool:
    """Return whether a position without a unit may be encoder counts: integers with a range above 720."""
    finite = values[np.isfinite(values)]
    return column.unit is None and len(finite) > 0 and bool(np.ptp(finite) > 720 and (finite == np.round(finite)).all())


def _find_doubts(recording: Recording, origin: Origin, has_gravity: bool) -> tuple[Note, ...]:
    """Check the unit of position: refuse an implausible guessed unit, and note an implausible given one."""
    try:
        checks.refuse_too_fast(recording, origin)
        return checks.check_unit(recording, origin) if has_gravity else ()
    except ColumnError as error:
        if not origin.columns["position"].has_unit:
            raise
        return (Note(NoteKind.IMPLAUSIBLE, ("position",), text=str(error)),)
