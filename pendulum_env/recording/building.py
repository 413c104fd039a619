"""Build a recording from raw columns: in SI units, cleaned, and in segments of uniform time."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta

import numpy as np

from pendulum_env._typing import JSON, Array
from pendulum_env.errors import ColumnError, RecordingError
from pendulum_env.quantity import Quantity
from pendulum_env.recording import checks, cleaning, jitter, sampling
from pendulum_env.recording.clock import find_date, find_unix_unit, unwrap_clock
from pendulum_env.recording.columns import FileColumn
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.origin import Origin
from pendulum_env.recording.record import NO_TORQUE, Recording
from pendulum_env.recording.table import RawTable
from pendulum_env.recording.vocabulary import OUTPUTS
from pendulum_env.servo import MOTOR, ServoDrive
from pendulum_env.servo.torque import complete_torque


def build_recording(
    name: str,
    table: RawTable,
    unwrap: bool,
    drive: ServoDrive | None,
    named_columns: Mapping[str, str],
    log_format: JSON,
    *,
    can_resample: bool,
) -> Recording:
    """Convert a table to SI units, clean it, cut it at gaps and make time uniform; refuse implausible data.

    `can_resample` to the clock of an encoder that is slower than its log.
    """
    values, actuator = table.values, drive or MOTOR
    columns, notes = _read_clock(table)
    origin = Origin(columns, named_columns, _are_counts(columns["position"], values["position"]))
    _convert_to_si(values, origin)
    if actuator.output == "duty" and actuator.supply is None and "supply" not in values:
        raise RecordingError(
            "a duty is a share of the supply: name its column (supply=...), or give the drive a supply [V]"
        )
    unit = columns["torque"].result_unit if "torque" in columns else actuator.unit
    is_output = unit == OUTPUTS.get(actuator.output)
    noted_columns = [column for column in columns.values() if not (is_output and column.quantity == "torque")]
    if "torque" not in values:
        values["torque"] = np.zeros_like(values["position"])  # with a drive, computed below
        if not actuator.is_controller:
            notes.append(Note(NoteKind.NO_TORQUE if "torque" in named_columns else NoteKind.NO_TORQUE_COLUMN))
    notes = [*(note for column in noted_columns for note in column.notes), *notes]
    log = cleaning.Log(values, notes, turns=cleaning.find_turns(values, columns), unwraps=unwrap)
    _clean_rows(log, can_resample=can_resample, can_swing=not actuator.is_controller)
    turn = log.turns["position"]
    checks.refuse_jumps(log.values["position"], log.rows, log.starts, origin, turn=turn, allow_wrapped=unwrap)
    jumps = cleaning.unwrap_positions(log, is_angle=not actuator.acts_on_speed) if unwrap else 0
    sampling.drop_short_segments(log)
    sampling.resample_uniformly(log)
    if "enabled" in log.values:
        _round_enabled(log, origin)
    recording = Recording(
        name=name,
        **log.values,  # type: ignore[arg-type]
        notes=tuple(log.notes),
        starts=log.starts,
        torque_unit=unit,
        drive=drive,
        origin=origin,
        log_format=log_format,
        start_date=find_date(log.start) or (table.date and table.date + timedelta(seconds=log.start)),
    )
    recording = complete_torque(recording)
    checks.refuse_implausible(recording, origin)
    if not jumps:  # jumps of 2 pi confirm the unit
        recording = replace(recording, notes=(*recording.notes, *_find_doubts(recording, origin)))
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


def _convert_to_si(values: dict[str, Array], origin: Origin) -> None:
    """Convert the columns to SI units in place; refuse implausible currents and counts of torque."""
    if "torque" in values:
        checks.refuse_large_current(values["torque"], origin)
        checks.refuse_torque_counts(values["torque"], origin)
    for quantity, column in origin.columns.items():
        with np.errstate(over="ignore", invalid="ignore"):  # overflows are treated as empty cells
            values[quantity] *= column.scale
            values[quantity] += column.offset


def _clean_rows(log: cleaning.Log, *, can_resample: bool, can_swing: bool) -> None:
    """Remove invalid rows, correct time stamps, and cut the log at gaps.

    `can_resample` to the clock of a slow encoder; without torque, a log that `can_swing` begins with the release.
    """
    checks.refuse_too_few(log.values["time"])
    cleaning.fill_unchanged(log)
    cleaning.align_topics(log, checks.BOUNDS.fewest)
    cleaning.drop_invalid_rows(log, checks.BOUNDS.fewest)
    cleaning.shift_restarted_runs(log)
    if cleaning.has_repeated_times(log):
        jitter.replace_late_stamps(log)
    cleaning.drop_repeated_times(log)
    has_torque = (np.abs(log.values["torque"]) > NO_TORQUE).any()
    if can_swing and not has_torque and np.ptp(log.values["position"]) > 0:
        cleaning.drop_initial_hold(log)
    cleaning.start_from_zero(log)
    if can_resample:
        jitter.resample_slow_encoder(log)
    cleaning.drop_spoilt_positions(log)
    checks.refuse_too_few(log.values["time"])
    checks.refuse_motionless(log.values["position"])
    jitter.replace_late_stamps(log)
    sampling.cut_at_gaps(log)


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


def _find_doubts(recording: Recording, origin: Origin) -> tuple[Note, ...]:
    """Check the unit of position: refuse an implausible guessed unit, and note an implausible given one."""
    try:
        checks.refuse_too_fast(recording, origin)
        return checks.check_unit(recording, origin)
    except ColumnError as error:
        if not origin.columns["position"].has_unit:
            raise
        return (Note(NoteKind.IMPLAUSIBLE, ("position",), text=str(error)),)
