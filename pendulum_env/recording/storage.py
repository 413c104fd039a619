"""Reading recordings from files and tables, with every doubt raised at once."""

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pendulum_env._typing import JSON, Array
from pendulum_env.errors import ColumnError, RecordingError
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.quantity import Quantity
from pendulum_env.recording import checks, cleaning, sampling
from pendulum_env.recording.cleaning import Log
from pendulum_env.recording.clock import find_unix_unit, unwrap_clock
from pendulum_env.recording.columns import NONE, FileColumn, check_named, find_columns
from pendulum_env.recording.formats import Readable, find_stem, get_label, read_table
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.origin import Origin
from pendulum_env.recording.record import Recording
from pendulum_env.recording.table import RawTable
from pendulum_env.recording.vocabulary import OUTPUTS
from pendulum_env.servo.drive import ServoDrive
from pendulum_env.servo.torque import MOTOR, complete_torque


@refuse_unknown_arguments
def read_recording(
    source: Readable,
    *,
    unwrap: bool = False,
    columns: Mapping[str, str | None] | None = None,
    drive: ServoDrive | None = None,
    name: str | None = None,
) -> Recording:
    """Read a file or table with columns time, position, torque and perhaps velocity, reference, segment and others.

    Without a torque column, and if no column of an unknown name could be one, it is a free swing: torque is zero.

    CSV (also .csv.gz, .tsv, .txt), Parquet, NPZ and MATLAB are read as they are; HDF5, MATLAB 7.3, Excel, MCAP and bags
    of ROS need the extra `formats`.

    Columns are found by common names, their units converted to s, rad, N m, rad/s; slightly uneven time is made
    uniform. Whatever was changed is said in the recording's `notes`.

    Args:
        source: path of a file; or a table in memory: a data frame of pandas or Polars, a table of pyarrow, or a mapping
            of arrays, which may be nested.
        unwrap: undo jumps of 2 pi in position, which are refused otherwise.
        columns: which column is which quantity, where the file's own names do not tell, by quantity (time, position,
            torque, velocity, reference, segment), each `NAME:UNIT*GAIN/RATIO+OFFSET`: `{"position": "-Winkel:deg/6",
            "torque": "current:A*0.091"}`; `none` or None leaves one out: torque is then zero. Units are s, ms, us, ns;
            rad, mrad, deg, rev, counts; rad/s, deg/s, rpm, rev/s, counts/s; Nm, mNm, Ncm, A, mA, V, duty. Counts need
            the counts of a turn (`enc:counts/4096`), and currents a torque constant (`*?` if it is to be found).
        drive: the controller that followed the reference. Then torque is what a column of its output (duty, current)
            or of the user's naming holds, or else what the controller asked for.
        name: of the recording; by default that of the file, or `recording`.

    Raises:
        TypeError: if the source is neither, or `columns` are no mapping of quantities to texts.
        RecordingError: if the file cannot be read or its content cannot be trusted: one sentence with the file, the
            data row (from 1, header and blank lines not counted) where there is one, the reason and the remedy.
    """
    check_named(columns)
    label, is_file = get_label(source, name), isinstance(source, str | os.PathLike)
    try:
        name = name or (find_stem(Path(label)) if is_file else label)
        output = None if drive is None else drive.output
        named = {quantity: NONE if text is None else text for quantity, text in (columns or {}).items()}
        table = read_table(source, partial(find_columns, named=named, output=output))
        return _build_recording(name, table, unwrap, drive, named)
    except RecordingError as error:
        raise type(error)(f"{label}: {error}") from error.__cause__


def describe_reading(columns: Mapping[str, str], unwrap: bool = False, drive: ServoDrive | None = None) -> JSON:
    """Describe the arguments of `read_recording` in the words of a study, without those that are not given."""
    given = {"columns": dict(columns), "unwrap": unwrap, "drive": drive and drive.get_settings()}
    return {key: value for key, value in given.items() if value}


def _build_recording(
    name: str, table: RawTable, unwrap: bool, drive: ServoDrive | None, named: Mapping[str, str]
) -> Recording:
    """Convert a table to SI, clean it, cut it at gaps and make time uniform; refuse implausible data."""
    columns, values = dict(table.columns), table.values
    counted = unwrap_clock(values["time"])
    notes = [*table.notes] + [Note(NoteKind.CLOCK_RESTARTED)] * (counted is not values["time"])
    values["time"] = counted
    unix = None if columns["time"].is_unit_told else find_unix_unit(values["time"])
    if unix is not None:
        columns["time"] = replace(columns["time"], unit=unix)
    origin = Origin(columns, named, _are_counts(columns["position"], values["position"]))
    if "torque" in values:
        checks.refuse_large_current(values["torque"], origin)
    for quantity, column in columns.items():
        with np.errstate(over="ignore", invalid="ignore"):  # what is beyond all numbers is left out like an empty cell
            values[quantity] *= column.scale
            values[quantity] += column.offset
    source = drive or MOTOR
    if source.output == "duty" and source.supply is None and "supply" not in values:
        raise RecordingError(
            "a duty is a share of the supply: name its column (supply=...), or give the drive a supply [V]"
        )
    unit = columns["torque"].result_unit if "torque" in columns else source.unit
    if "torque" not in values:
        values["torque"] = np.zeros_like(values["position"])  # of a drive until the motion is known
        if drive is None:
            notes.append(Note(NoteKind.NO_TORQUE if "torque" in named else NoteKind.NO_TORQUE_COLUMN))
    checks.refuse_too_few(values["time"])

    def turns() -> Array:
        return np.unwrap(log.values["position"]) if unwrap else log.values["position"]

    is_output = unit == OUTPUTS.get(source.output)
    noted = [own for own in columns.values() if not (is_output and own.quantity == "torque")]
    log = Log(values, [*(note for column in noted for note in column.notes), *notes])
    cleaning.fill_unchanged(log)
    cleaning.align_topics(log, checks.BOUNDS.fewest)
    cleaning.drop_invalid_rows(log, checks.BOUNDS.fewest)
    cleaning.shift_restarted_runs(log)
    cleaning.drop_repeated_times(log)
    if drive is None and not log.values["torque"].any() and np.ptp(log.values["position"]) > 0:
        cleaning.drop_initial_hold(log, turns())
    cleaning.start_from_zero(log)
    cleaning.drop_spoilt_positions(log, turns())
    checks.refuse_too_few(log.values["time"])
    checks.refuse_still(log.values["position"])
    sampling.cut_at_gaps(log, turns())
    checks.refuse_jumps(log.values["position"], log.rows, log.starts, origin, allow_wrapped=unwrap)
    jumps = _unwrap(log, is_angle=not source.acts_on_speed) if unwrap else 0
    sampling.drop_short_segments(log)
    sampling.resample_uniformly(log)
    signals: dict[str, Any] = {**log.values}
    if "enabled" in signals:
        signals["enabled"] = np.asarray(signals["enabled"] > 0.5, dtype=float)
    recording = Recording(
        name=name,
        **signals,
        notes=tuple(log.notes),
        starts=log.starts,
        torque_unit=unit,
        drive=drive,
        origin=origin,
        log_format=describe_reading(named, unwrap, drive),
        start_date=log.clock.date or (table.date and table.date + timedelta(seconds=log.clock.start)),
    )
    recording = complete_torque(recording)
    checks.refuse_too_short(recording, origin)
    checks.refuse_foreign_reference(recording, origin)
    checks.refuse_torque_twice(recording, origin)
    if recording.velocity is not None:
        checks.refuse_foreign_velocity(recording, origin)
    if not jumps:  # of 2 pi, which tell the unit
        recording = replace(recording, notes=(*recording.notes, *_find_doubts(recording, origin)))
    return recording


def _are_counts(column: FileColumn, values: Array) -> bool:
    """Return whether a position without a unit may be encoder counts: whole numbers that cover over 720."""
    finite = values[np.isfinite(values)]
    return column.unit is None and len(finite) > 0 and bool(np.ptp(finite) > 720 and (finite == np.round(finite)).all())


def _find_doubts(recording: Recording, origin: Origin) -> tuple[Note, ...]:
    """Find doubts about the unit of position: refuse a guessed unit, note a given one."""
    try:
        checks.refuse_too_fast(recording, origin)
        return checks.check_unit(recording, origin)
    except ColumnError as error:
        if not origin.columns["position"].is_unit_told:
            raise
        return (Note(NoteKind.IMPLAUSIBLE, ("position",), text=str(error)),)


def _unwrap(log: Log, is_angle: bool) -> int:
    """Undo jumps of 2 pi in position, a reference that `is_angle` following; returns how many there were."""
    position = log.values["position"]
    unwrapped = np.unwrap(position)
    log.values = {**log.values, "position": unwrapped}
    if "reference" in log.values and is_angle:  # on the turn that the joint is on
        reference = log.values["reference"]
        log.values["reference"] = reference + math.tau * np.round((unwrapped - reference) / math.tau)
    jumps = int(np.count_nonzero(np.abs(np.diff(position)) > np.pi))
    if jumps:
        log.notes.append(Note(NoteKind.UNWRAPPED, ("position",), {"count": Quantity(jumps)}))
    return jumps
