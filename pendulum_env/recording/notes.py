"""Notes on changes and guesses while reading a recording, without texts, which the narrator has."""

import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from pendulum_env.notebook import summarise
from pendulum_env.quantity import Quantity


class NoteKind(StrEnum):
    """Kind of a note; comments name the fields in addition to the quantities."""

    # columns of the file
    TRANSFORMED = "transformed"  # text: the user's expression
    CONVERTED = "converted"  # headers, text: the unit
    UNIT_CONTRADICTED = "unit_contradicted"  # headers: the column, the unit in its name, and the unit of the user
    UNIT_INFERRED = "unit_inferred"  # headers: the column, and the unit of its name; text: expression without it
    GAIN_UNKNOWN = "gain_unknown"  # text: the unit
    COMMANDED_TORQUE = "commanded_torque"  # headers
    INTEGRAL = "integral"  # headers
    LOAD_TORQUE_ALONE = "load_torque_alone"  # headers
    LOAD_TORQUE = "load_torque"  # headers
    PASSED_OVER = "passed_over"  # headers: the selected one, then the others
    MOTOR_OFF = "motor_off"  # count, rows, headers
    NO_TORQUE = "no_torque"
    NO_TORQUE_COLUMN = "no_torque_column"
    TORQUE_OF_DRIVE = "torque_of_drive"
    UNSIGNED = "unsigned"  # headers
    TORQUE_BY_OUTPUT = "torque_by_output"  # text: the output; headers: its unit
    OTHER_TOPIC = "other_topic"  # headers: the topic, then the topic of position
    DATASET_UNIT = "dataset_unit"  # headers: joints; text: degrees, radians, percent, percent without range, or unknown
    SPARSE = "sparse"  # count, rows, empty or infinite

    # rows of the file
    FIRST_DATE = "first_date"  # text: the date
    LAST_ROW_CUT = "last_row_cut"
    TIME_OF_TWO = "time_of_two"  # headers: seconds, and their fraction
    CLOCK_RESTARTED = "clock_restarted"
    CELLS_HELD = "cells_held"
    OTHER_ROWS = "other_rows"  # held or interpolated
    SPOILT = "spoilt"  # count, places: rows; empty, infinite or of unknown time
    TIME_REPEATED = "time_repeated"  # count, places: rows
    GLITCHES = "glitches"  # count, places: rows
    STALE = "stale"  # count, places: rows
    ENCODER_SLOW = "encoder_slow"  # rate, rows
    HELD_AT_FIRST = "held_at_first"  # time
    OFFSET = "offset"  # offset
    UNWRAPPED = "unwrapped"  # count, turn

    # time
    GAPS = "gaps"  # count, shortest, longest, places: times
    SHORT_SEGMENTS = "short_segments"  # count, samples, least
    FILLED = "filled"  # count, places: times
    STAMPS_LATE = "stamps_late"  # rate, std
    CLOCK_ROUNDED = "clock_rounded"  # rate, error
    RESAMPLED = "resampled"  # rate, shortest, longest, std, slow, ratio
    ALIGNED = "aligned"  # delay, lag; neither where it is half a sample

    # uncertain units
    MAY_BE_DEGREES = "may_be_degrees"  # low, high, columns that read degrees
    IMPLAUSIBLE = "implausible"  # text: the error for a guessed unit


NAMED = 5  # most rows or times of a note
WARNED = frozenset(  # kinds that are warnings in Python: rows or columns that are left out, and uncertain units
    {
        NoteKind.SPOILT,
        NoteKind.SPARSE,
        NoteKind.TIME_REPEATED,
        NoteKind.GLITCHES,
        NoteKind.STALE,
        NoteKind.SHORT_SEGMENTS,
        NoteKind.UNIT_CONTRADICTED,
        NoteKind.UNIT_INFERRED,
        NoteKind.MAY_BE_DEGREES,
        NoteKind.IMPLAUSIBLE,
    }
)
# modules whose frames a warning passes over; functools calls the function for a type
PASSED_MODULES = ("pendulum_env", "estimators", "agents", "robots", "workbench", "functools")


class RecordingWarning(UserWarning):
    """Rows or columns of a recording that are left out, or units that are uncertain."""


@dataclass(frozen=True)
class Note:
    """Note on a change or guess while reading a recording.

    Attributes:
        kind: kind of the note.
        quantities: quantities of the recording; of several joints, with the joint.
        numbers: numbers by name, see `NoteKind`.
        headers: names of columns of the file or of topics.
        places: first `NAMED` rows of the file, from 1, or times [s].
        text: text of the file, the user or an error.
        columns: option `columns` that reads the file differently.
    """

    kind: NoteKind
    quantities: tuple[str, ...] = ()
    numbers: Mapping[str, Quantity] = field(default_factory=dict)
    headers: tuple[str, ...] = ()
    places: tuple[float, ...] = ()
    text: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return summarise(self)


def warn_of_notes(name: str, notes: Sequence[Note]) -> None:
    """Warn once of the notes of a recording whose kind is in `WARNED`, at the line of the user that reads it."""
    texts = [str(note).removeprefix("warning: ") for note in notes if note.kind in WARNED]
    if texts:
        warnings.warn(f"{name}: {'; '.join(texts)}", RecordingWarning, stacklevel=_find_user_level())


def _find_user_level() -> int:
    """Return the `stacklevel`, in `warn_of_notes`, of the first frame outside of this project."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in PASSED_MODULES:
        level, frame = level + 1, frame.f_back
    return level
