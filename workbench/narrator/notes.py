"""Texts of notes on recordings."""

import math
from collections.abc import Callable, Mapping, Sequence

from pendulum_env.formatting import join_words
from pendulum_env.recording.notes import NAMED, Note, NoteKind
from pendulum_env.settings import format_setting

WARNING = "warning: "  # prefix of a note on a likely error


def describe_note(note: Note) -> str:
    """Describe a note in a phrase."""
    numbers = {name: number.value for name, number in note.numbers.items()}
    words = {"quantity": join_words(note.quantities), "text": note.text}
    words["columns"] = format_setting("columns", note.columns)
    words |= {f"header{k or ''}": name for k, name in enumerate(note.headers)}
    if note.kind in PLACES:
        words["places"] = PLACES[note.kind](note)
    if note.kind in VARIANTS:
        words["variant"] = VARIANTS[note.kind](note)
    return TEXTS[note.kind].format(**words, **numbers)


def _name_rows(note: Note) -> str:
    """List rows of a file: `data row 12`, or `3 data rows (12, 14 and 20)`."""
    rows = [f"{row:g}" for row in note.places]
    if len(rows) == 1:
        return f"data row {rows[0]}"
    count = note.numbers["count"].value
    rest_text = [f"{count - len(rows):g} more"] if count > len(rows) else []
    return f"{count:g} data rows ({join_words([*rows, *rest_text])})"


def _name_times(note: Note) -> str:
    """List times: `1.2 s`, or `1.2, 3.4 s and 5 more times`."""
    n_more = note.numbers["times"].value - len(note.places)
    times = ", ".join(f"{time:.6g}" for time in note.places) + " s"
    return f"{times} and {n_more:g} more times" if n_more else times


def _name_headers(headers: Sequence[str]) -> str:
    """List at most `NAMED` columns with their verb: `'tau' is`, or `'a', 'b' and 7 more are`."""
    named, n_more = [repr(header) for header in headers[:NAMED]], len(headers) - NAMED
    return join_words([*named, f"{n_more} more"] if n_more > 0 else named) + (" is" if len(headers) == 1 else " are")


def _choose_by_count(singular: str, plural: str) -> Callable[[Note], str]:
    """Make a function that formats the singular or plural text with the numbers of a note."""
    return lambda note: (singular if note.numbers["count"].value == 1 else plural).format(
        **{name: number.value for name, number in note.numbers.items()}
    )


DATASET_UNITS = {
    "degrees": "degrees, as the steps show,",
    "percent": "percent of the calibrated range",
    "percent without range": "percent of the range",
    "unknown": "an unknown unit",
}
ROWS = (NoteKind.SPOILT, NoteKind.TIME_REPEATED, NoteKind.GLITCHES, NoteKind.STALE)
PLACES = dict.fromkeys(ROWS, _name_rows) | dict.fromkeys((NoteKind.GAPS, NoteKind.FILLED), _name_times)
VARIANTS: Mapping[NoteKind, Callable[[Note], str]] = {
    NoteKind.OTHER_ROWS: lambda note: {"held": "as it was last"}.get(note.text, "by interpolation"),
    NoteKind.DATASET_UNIT: lambda note: (
        f"{_name_headers(note.headers)} in {DATASET_UNITS.get(note.text, note.text)} in the dataset"
        + (": left out, as LeRobot's calibration file is missing" if note.text == "percent without range" else "")
    ),
    NoteKind.PASSED_OVER: lambda note: _name_headers(note.headers[1:]),
    NoteKind.SPOILT: lambda note: "is" if len(note.quantities) == 1 else "are",
    NoteKind.UNWRAPPED: lambda note: (
        "2 pi" if (turn := note.numbers["turn"].value) == math.tau else f"{turn:.4g} rad, a turn of its encoder"
    ),
    NoteKind.GAPS: _choose_by_count("a gap of", "{count:g} gaps of {shortest:.3g} to"),
    NoteKind.SHORT_SEGMENTS: _choose_by_count("a segment", "{count:g} segments"),
    NoteKind.FILLED: _choose_by_count("1 sample is", "{count:g} samples are"),
    NoteKind.RESAMPLED: lambda note: (
        f", {note.numbers['slow'].value:g} of them over {note.numbers['ratio'].value:g} times the usual"
        if "slow" in note.numbers
        else ""
    ),
    NoteKind.ALIGNED: lambda note: (
        ", ".join(f"{name} {1e3 * size.value:.3g} ms" for name, size in note.numbers.items()) or "half a sample"
    ),
}
TEXTS: Mapping[NoteKind, str] = {
    NoteKind.TRANSFORMED: "{quantity} is {text}",
    NoteKind.CONVERTED: "{quantity} converted to {text} from column {header!r}",
    NoteKind.UNIT_CONTRADICTED: (
        f"{WARNING}{{quantity}} is read in {{header2}}, although the name of column {{header!r}} says {{header1}}"
    ),
    NoteKind.UNIT_INFERRED: (
        f"{WARNING}{{quantity}} is read in {{header1}}, by the name {{header!r}}, before the factor: if the factor "
        "converts the unit, write {text}"
    ),
    NoteKind.GAIN_UNKNOWN: "{quantity} is in {text}, its gain to be found",
    NoteKind.COMMANDED_TORQUE: "{quantity} is the commanded one, from column {header!r}",
    NoteKind.INTEGRAL: "{quantity} is the integral of column {header!r}, from an unknown zero, in each segment another",
    NoteKind.LOAD_TORQUE_ALONE: "{quantity} is that of column {header!r}: the log has no other torque",
    NoteKind.LOAD_TORQUE: "column {header!r} is read as a load torque, which adds to torque",
    NoteKind.PASSED_OVER: "{quantity} is taken from column {header!r}; {variant} there too",
    NoteKind.MOTOR_OFF: "column {header!r} says that the motor is off in {count:g} of {rows:g} rows: torque is 0 there",
    NoteKind.NO_TORQUE: "torque is taken as none: the recording is a free swing (torque 0)",
    NoteKind.NO_TORQUE_COLUMN: "no torque column: the recording is a free swing (torque 0)",
    NoteKind.TORQUE_OF_DRIVE: "torque is not taken from the log: it is computed from the drive",
    NoteKind.UNSIGNED: "column {header!r} is left out: it is never negative while the motion reverses, without a sign",
    NoteKind.TORQUE_BY_OUTPUT: "torque is the {text} that was logged, in {header} by the drive",
    NoteKind.OTHER_TOPIC: "{quantity} is taken from {header} at the times of {header1}",
    NoteKind.DATASET_UNIT: "{variant}",
    NoteKind.SPARSE: "{quantity} is left out: it is {text} in {count:g} of {rows:.0f} rows",
    NoteKind.FIRST_DATE: "time is counted from {text}",
    NoteKind.LAST_ROW_CUT: "the last row is cut off: left out",
    NoteKind.TIME_OF_TWO: "time is the sum of columns {header!r} and {header1!r}",
    NoteKind.CLOCK_RESTARTED: "the counter of time began again: time goes on there",
    NoteKind.CELLS_HELD: "empty cells hold the last value: the file repeats no value",
    NoteKind.OTHER_ROWS: "{quantity} stands in other rows than position: taken {variant}",
    NoteKind.SPOILT: "{quantity} {variant} {text} in {places}: left out",
    NoteKind.TIME_REPEATED: "time repeats that of the row before in {places}: left out",
    NoteKind.GLITCHES: "{quantity} jumps for one sample in {places}: left out",
    NoteKind.STALE: "{quantity} stays behind while the joint moves on in {places}: left out",
    NoteKind.ENCODER_SLOW: (
        "{quantity} has a new value every {rows:.3g} rows: samples are taken at {rate:.6g} Hz, the clock of its "
        "encoder; torque with another clock is averaged in between"
    ),
    NoteKind.HELD_AT_FIRST: "{quantity} is held until {time:.2f} s: this part is left out, the swing after it is free",
    NoteKind.OFFSET: "{quantity} is {offset:.2g} rad/s on average at rest: subtracted",
    NoteKind.UNWRAPPED: "{quantity} unwrapped at {count:g} jumps of {variant}",
    NoteKind.GAPS: "{variant} {longest:.3g} s after {places}: segments end there",
    NoteKind.SHORT_SEGMENTS: "{samples:.0f} samples in {variant} shorter than {least:g} s are left out",
    NoteKind.FILLED: "{variant} missing after {places}: filled in by interpolation",
    NoteKind.STAMPS_LATE: (
        "time set to uniform {rate:.6g} Hz: the stamps deviate by {std:.2g} ms (standard deviation), but position "
        "shows uniform samples"
    ),
    NoteKind.CLOCK_ROUNDED: (
        "time set to uniform {rate:.6g} Hz, from which it differed by rounding only (up to {error:.2g} s)"
    ),
    NoteKind.RESAMPLED: (
        "resampled to {rate:.6g} Hz: steps were {shortest:.4g} to {longest:.4g} ms (standard deviation {std:.2g} ms)"
        "{variant}"
    ),
    NoteKind.ALIGNED: "aligned: {variant}",
    NoteKind.MAY_BE_DEGREES: (
        "{quantity} runs from {low:.4g} to {high:.4g} and is taken as radians, on which a spring acts; if it is "
        "degrees, read it with {columns}"
    ),
    NoteKind.IMPLAUSIBLE: WARNING + "{text}",
}
