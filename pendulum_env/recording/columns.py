"""Find quantity and unit of the columns of a file, by their names or the user's options.

A name is an alias (`q`, `tau`, ...) of `vocabulary.py`. It may have a prefix or suffix (`q_meas`, `actual_position`), a
unit (`q [rad]`, `pos_deg`, `time_ms`) or a path (`/joint_states/position[0]`, `signals.theta`). Case is ignored. Names
with an unknown unit, a unit of current or encoder counts do not match. Users give columns by the names in the file,
with their conversion; see `expression.py`.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

from pendulum_env.errors import ColumnError
from pendulum_env.lookup import UnknownName, find
from pendulum_env.reading import quote_value
from pendulum_env.recording.expression import (
    LONGEST_UNIT,
    Expression,
    UnknownColumnError,
    UnknownUnitError,
    normalise_name,
    parse_expression,
)
from pendulum_env.recording.notes import Note, NoteKind
from pendulum_env.recording.vocabulary import (
    ALIASES,
    DRIVEN_ONLY,
    FIRST_MATCHING,
    HEADER,
    INDICES,
    LABELS,
    LINEAR,
    MOTEUS,
    MOTEUS_REGISTERS,
    NO_TORQUE,
    OPTIONAL,
    OUTPUTS,
    PERCENT_OF_RANGE,
    RAW,
    RAW_NAMES,
    SI,
    TORQUE_GAINS,
    UNIT_NAMES,
    UNITS,
    UNITS_OF_NO_TORQUE,
    UNSCALED,
    Rank,
    find_name,
    may_be_unit,
    read_words,
    split_words,
)
from pendulum_env.settings import Blank, format_setting
from pendulum_env.units import JointUnits

ADDITIONS = re.compile(
    r"^\[[^\]]*\]\s*(?=\w)|^(?:latest|run\s*#?\d+)\s*:\s*|^[%#]\s*|\s*\brun\s*#?\d+$", re.IGNORECASE
)  # additions of programs to names
VALUES = ("data", "value", "values")  # fields of a structure with samples
COUNTERS = ("sample", "samples", "samplenumber", "sampleindex", "frame", "framenumber", "index")
CLOCKS = frozenset((*ALIASES["time"].split(), "in", "sim", "system"))  # words of the names of clocks
LONGEST_HEADER, LONGEST_LIST = 40, 100  # characters of a header in a sentence, and of all together
NO_EXPRESSION = Expression("")  # of a column that the user did not name
NONE = "none"  # in place of a column: the quantity is omitted


@dataclass(frozen=True)
class FileColumn:
    """Recognised column of a file; the quantity in SI units is `scale` times the column plus `offset`."""

    quantity: str  # time, position, velocity, torque, reference or segment
    header: str  # name in the file
    index: int  # place in the file, from 0
    unit: str | None  # letters of the unit; None if not given
    rank: Rank = Rank.MEASURED  # measured, estimated or commanded, by its name
    other_candidates: tuple[str, ...] = ()  # names of other candidates for the quantity
    expression: Expression = NO_EXPRESSION  # expression of the user; empty if not given
    is_unit_inferred: bool = False  # whether the unit of the expression is that of the name alone
    is_integral: bool = False  # whether the quantity is the integral of the column
    digits: int | None = None  # significant digits to which the column is rounded; None for a constant step
    step: float = 0.0  # least change from row to row, in the unit of the file

    @property
    def scale(self) -> float:
        """Return the factor from the column to SI units."""
        if self.is_integral:
            return 1.0
        return _find_factor(self.quantity, self.unit) * self.expression.gain

    @property
    def offset(self) -> float:
        """Return the offset in SI units."""
        if self.is_integral:
            return 0.0
        unit = self.unit if self.expression.offset_unit is None else normalise_name(self.expression.offset_unit)
        return self.expression.shift * _find_factor(self.quantity, unit)

    @property
    def turn(self) -> float:
        """Return a turn of the encoder in the quantity [rad]; the first factor of counts is their number in a turn."""
        factors = self.expression.factors[self.unit in RAW["position"] :]
        return math.tau * abs(Expression("", factors=factors).gain)

    @property
    def has_unit(self) -> bool:
        """Return whether the unit is given by the name or the user."""
        return self.unit is not None or bool(self.expression.factors)

    @property
    def is_raw(self) -> bool:
        """Return whether the column is a current, a duty, a voltage or counts, which a gain converts."""
        return self.unit in RAW.get(self.quantity, {}) or (self.unit is None and _is_raw(self.quantity, self.header))

    @property
    def is_current_by_guess(self) -> bool:
        """Return whether the column is a current with the guessed unit A."""
        if self.quantity != "torque" or self.unit not in (None, "a") or find_trailing_unit(RAW["torque"], self.header):
            return False
        return self.unit == "a" or (_is_raw("torque", self.header) and _find_header_raw_unit(self.header) == "A")

    @property
    def result_unit(self) -> str:
        """Return the unit of the result: SI, or the column's unit for torque with an unknown gain."""
        if not self.expression.is_gain_unknown:
            return SI[self.quantity]
        return _find_raw_unit(self.unit or "duty")

    @property
    def notes(self) -> tuple[Note, ...]:
        """Return the notes on the conversion of the column."""
        notes, quantities, header = [], (self.quantity,), (self.header,)
        if self.is_integral:
            return (Note(NoteKind.INTEGRAL, quantities, headers=header),)
        if self.expression.factors or self.expression.offset or self.expression.is_negative:
            notes.append(Note(NoteKind.TRANSFORMED, quantities, text=str(self.expression)))
        elif self.scale != 1.0:
            si = SI[self.quantity]
            unit = JointUnits(is_prismatic=self.unit in LINEAR.get(self.quantity, {})).unit(si)
            notes.append(Note(NoteKind.CONVERTED, quantities, headers=header, text=unit))
        if self.is_unit_inferred and self.expression.factors and _find_factor(self.quantity, self.unit) != 1.0:
            plain = str(replace(self.expression, unit=SI[self.quantity].replace(" ", "")))
            units = (self.header, self.expression.unit or "")
            notes.append(Note(NoteKind.UNIT_INFERRED, quantities, headers=units, text=plain))
        if unit_in_name := self._find_contradicted_unit():
            units = (write_unit(self.quantity, unit_in_name), self.expression.unit or "")
            notes.append(Note(NoteKind.UNIT_CONTRADICTED, quantities, headers=(self.header, *units)))
        if self.result_unit != SI[self.quantity]:
            notes.append(Note(NoteKind.GAIN_UNKNOWN, quantities, text=self.result_unit))
        if self.rank is Rank.COMMANDED and normalise_name(self.header) != "u":  # `u` is always a command
            notes.append(Note(NoteKind.COMMANDED_TORQUE, quantities, headers=header))
        if self.quantity == "torque" and (find_name(self.header) or ("",))[0] == "load_torque":
            notes.append(Note(NoteKind.LOAD_TORQUE_ALONE, quantities, headers=header))
        if self.quantity == "load_torque":
            notes.append(Note(NoteKind.LOAD_TORQUE, quantities, headers=header))
        if self.other_candidates:
            notes.append(Note(NoteKind.PASSED_OVER, quantities, headers=(self.header, *self.other_candidates)))
        return tuple(notes)

    def _find_contradicted_unit(self) -> str | None:
        """Return the unit at the end of the name if the user gave another one; a single letter counts in brackets."""
        if self.expression.unit is None:
            return None
        raw = RAW.get(self.quantity, {})
        unit_in_name = find_trailing_unit({**UNITS[self.quantity], **raw}, self.header)
        if unit_in_name is None or (len(unit_in_name) == 1 and self.header.strip()[-1] not in "])"):
            return None
        factors = [_find_factor(self.quantity, unit) for unit in (unit_in_name, self.unit)]
        is_same = (unit_in_name in raw) == (self.unit in raw) and factors[0] == factors[1]
        return None if is_same else unit_in_name


def _find_factor(quantity: str, unit: str | None) -> float:
    return 1.0 if unit is None else list_unit_factors(quantity)[unit]


def list_unit_factors(quantity: str) -> dict[str, float]:
    """Return the factors from the units of a quantity to SI units, by the letters of the unit."""
    return {**UNITS[quantity], **RAW.get(quantity, {}), **LINEAR.get(quantity, {})}


def find_columns(
    headers: Sequence[str],
    named_columns: Mapping[str, str] | None = None,
    output: str | None = None,
    *,
    text_columns: Collection[int] = (),
    date_columns: Collection[int] = (),
) -> dict[str, FileColumn]:
    """Find the columns of time, position, torque and, if present, `OPTIONAL`, by quantity.

    Without a position, it is the integral of the velocity. Torque may be missing only if the user gives `none`, or no
    other column can be torque, see `can_be_torque`.

    Args:
        headers: names of the columns in the file.
        named_columns: expressions of the user by quantity, see `expression.py`, or `none` to leave a quantity out;
            the others are found by their names.
        output: output of a known controller that followed the reference, or None. With a controller, the reference is
            needed, and torque is the column that the user names, or else a column of that output.
        text_columns: places of columns that hold no numbers; they give way to others.
        date_columns: places of columns that hold dates or times of day.

    Returns:
        Columns by quantity. Column `fraction` has the fraction of each second, if `time` has whole seconds.
    """
    expressions = {quantity: text.strip() for quantity, text in (named_columns or {}).items()}
    omitted = {q for q in (*OPTIONAL, "position", "torque") if expressions.get(q) == NONE and NONE not in headers}
    columns = {q: parse_column(q, text, headers) for q, text in expressions.items() if q not in omitted}
    used = {column.index for column in columns.values()}
    positions, torque = [columns["position"]] if "position" in columns else [], columns.get("torque")
    if not positions and "position" not in omitted:  # without a position, the integral of a velocity
        matches = _find_positions(headers, torque, used, text_columns)
        positions = _prefer_measured(matches)
        if len(positions) > 1 and torque:
            positions = _select_joint(read_words(torque.header).label, positions) or positions
        columns |= _choose_column("position", positions, matches, expressions, text_columns)
    label = read_words(positions[0].header).label if len(positions) == 1 else None
    for quantity in (q for q in ALIASES if q not in columns and q not in omitted and q != "position"):
        matches = _find_candidates(quantity, headers, used)
        if quantity == "time":
            matches = _drop_fractions(matches or _find_clocks(headers, date_columns, used), headers)
        elif label is not None and not matches:
            matches = _select_joint(label, _find_by_words(quantity, headers, {*used, *text_columns}))
        candidates = _prefer_measured([c for c in matches if c.index not in text_columns] or matches)
        if quantity == "time" and len(candidates) > 1:
            candidates = (len(positions) == 1 and _match_path(positions[0], candidates)) or candidates
        elif len(candidates) > 1 and label is not None:
            of_joint = _select_joint(label, candidates)
            is_missing = quantity == "velocity" and len(of_joint) != 1
            candidates = [] if is_missing else of_joint or candidates
        if quantity in FIRST_MATCHING:
            candidates = candidates[:1]
        if quantity == "torque" and output is not None:
            expression = _find_output(output, headers)
            candidates = [] if expression is None else [parse_column(quantity, expression, headers)]
        columns |= _choose_column(quantity, candidates, matches, expressions, text_columns)
    if "torque" not in columns and "load_torque" in columns and output is None:
        if "torque" in omitted or not any(_is_raw("torque", header) for header in headers):  # without a motor
            columns["torque"] = replace(columns.pop("load_torque"), quantity="torque")
    if (
        "position" not in columns
        and "velocity" in columns
        and ("position" in omitted or not any(map(_can_be_position, headers)))
    ):
        unit = "m" if columns["velocity"].unit in LINEAR["velocity"] else "rad"
        columns["position"] = replace(columns["velocity"], quantity="position", unit=unit, is_integral=True)
    required = ("time", "position", "torque" if output is None else "reference")
    missing = [
        name for name in required if name not in columns and (name == "position" or expressions.get(name) != NONE)
    ]
    chosen = {column.index for column in columns.values()}.union(text_columns)
    unused = {k: header for k, header in enumerate(headers) if k not in chosen}
    is_swing = columns.keys().isdisjoint(DRIVEN_ONLY) and not any(can_be_torque(unused[k], k) for k in unused)
    if missing and not (missing == ["torque"] and is_swing):
        _refuse_missing(missing, headers, list(unused.values()), expressions, "reference" in columns)
    return _complete_columns({quantity: columns[quantity] for quantity in ALIASES if quantity in columns}, headers)


def _can_be_position(header: str) -> bool:
    """Return whether a column may be a position, perhaps in another unit."""
    return _is_raw("position", header) or read_words(header.strip()).quantity == "position"


def _complete_columns(columns: dict[str, FileColumn], headers: Sequence[str]) -> dict[str, FileColumn]:
    """Add the unit of position to the reference, the fraction of seconds, and the units of a moteus log."""
    if "reference" in columns and columns["reference"].unit is None and columns["position"].unit in UNITS["position"]:
        columns["reference"] = replace(columns["reference"], unit=columns["position"].unit)
    if "time" in columns and (fraction := _find_fraction(columns["time"], headers)):
        columns["fraction"] = fraction
    for quantity in MOTEUS:
        if (column := columns.get(quantity)) and column.unit is None and not column.expression.name:
            columns[quantity] = replace(column, unit=_find_moteus_unit(column.header, headers))
    return columns


def _choose_column(
    quantity: str,
    candidates: Sequence[FileColumn],
    matches: Sequence[FileColumn],
    expressions: Mapping[str, str],
    text_columns: Collection[int],
) -> dict[str, FileColumn]:
    """Return the column of a quantity, which names its other matches; empty without one. Refuse several candidates."""
    if len(candidates) > 1:
        names = " and ".join(quote_value(c.header.strip(), LONGEST_HEADER) for c in candidates[:3])
        raise ColumnError(
            f"columns {names} could {'both' if len(candidates) == 2 else 'all'} be {quantity}: "
            f"say which with {format_setting('columns', {**expressions, quantity: 'NAME'})}"
        )
    others = tuple(c.header for c in matches if c not in candidates and c.index not in text_columns)
    return {quantity: replace(candidates[0], other_candidates=others)} if candidates else {}


def _refuse_missing(
    missing: list[str], headers: Sequence[str], unused: Sequence[str], expressions: Mapping[str, str], has_goal: bool
) -> NoReturn:
    """Refuse a file without the needed columns; suggest columns among `headers` and the unused ones in `unused`."""
    option = format_setting("columns", {**expressions, **dict.fromkeys(missing, "NAME")})
    speeds = [quote_value(h.strip(), LONGEST_HEADER) for h in headers if read_words(h.strip()).quantity == "velocity"]
    suggested = {q: suggestion for q in missing if (suggestion := _suggest_column(q, headers, unused))}
    hints = []
    if suggested:
        reasons, texts, meanings = zip(*suggested.values(), strict=True)
        names = {**expressions, **dict.fromkeys(missing, "NAME"), **dict(zip(suggested, texts, strict=True))}
        example = format_setting("columns", names)
        hints = [f"{' and '.join(reasons)}, as in {example}{' and'.join(filter(None, meanings))}"]
    if missing == ["reference"]:
        hints = [f"say which is the goal with {option}"]
    elif len(joints := _find_joints(headers)) > 1:
        robot = format_setting("robot", "ARM.urdf")
        hints = [f"there are some for {_list_headers(joints)}: an arm needs {robot}, one joint needs {option}"]
    elif "position" in set(missing) - set(suggested) and speeds:
        hints.append(f"{speeds[0]} is a velocity. Log position, as an integrated velocity has noise that is not white")
    elif not suggested:
        hints.append(f"name the columns {HEADER} (in s, rad, N m), or say which with {option}")
    if "time" in missing:
        hints.append("if the log has no times, add a column of them: the number of the row over the rate in Hz")
    if "torque" in missing and len(joints) < 2:
        drive = f", or {format_setting('drive', Blank('...'))} if a controller follows the goal" if has_goal else ""
        none = f"write torque={NONE}"
        if missing == ["torque"]:
            none = format_setting("columns", {**expressions, "torque": NONE})
        hints.append(f"{none} if nothing drives the joint{drive}")
    among = f"among {_list_headers(headers)}" if headers else "(the file has no columns)"
    raise ColumnError(f"no column for {', '.join(missing)} {among}: {'; '.join(hints)}")


def _suggest_column(quantity: str, headers: Sequence[str], unused: Sequence[str]) -> tuple[str, str, str] | None:
    """Suggest the first column of an unknown name with a unit of the quantity, or that holds it up to a gain.

    Returns the reason, the expression of the column, and the meaning of its gain.
    """
    readings = {header: read_words(header.strip()) for header in headers}
    pairs = [h for h in headers if h.endswith("[0]") and f"{h[:-3]}[1]" in headers and f"{h[:-3]}[2]" not in headers]
    unused = [header for header in unused if header not in pairs]
    raw = [h for h in headers if _is_raw(quantity, h) or (readings[h].is_raw and readings[h].quantity == quantity)]
    raw.sort(key=lambda header: bool(readings[header].label))  # `current_motor` before `current_in`
    if quantity == "torque":
        raw.sort(key=_find_header_raw_unit)  # currents first
    named_headers = [h for h in unused if readings[h].quantity == quantity and not readings[h].is_raw]
    unscaled_headers = [header for header in named_headers if is_unscaled(header)]
    suggestions: list[tuple[str, list[str], str, str]] = [
        ("may count samples", [h for h in headers if normalise_name(h) in COUNTERS], "/RATE", " with their rate [Hz]"),
        ("may be the time", pairs, "", ""),  # as Simulink saves signals
        ("has its unit", [header for header in unused if find_trailing_unit(UNITS[quantity], header)], "", ""),
        ("may be it", [header for header in named_headers if header not in unscaled_headers], "", ""),
        ("needs a gain", raw, *(_write_gain(quantity, raw[0].strip()) if raw else ("", ""))),
        ("needs a gain", unscaled_headers, "*0.001", f" with the {SI[quantity]} in a unit of it"),
    ]
    for reason, matches, conversion, meaning in suggestions if quantity == "time" else suggestions[2:]:
        for header in matches:
            return f"{quote_value(header.strip(), LONGEST_HEADER)} {reason}", header.strip() + conversion, meaning
    return None


def can_be_torque(header: str, place: int) -> bool:
    """Return whether an unrecognised column may be torque: its name has no unit or quantity of another kind.

    A reference, a supply or a power switch implies a motor, whose torque is unknown.
    """
    bare, words = header.strip(), set(split_words(header))
    if not bare or bare.lower() in INDICES:
        return not bare and place > 0  # row numbers of pandas
    quantities = {match[0] for spelling in _list_spellings(header) if (match := find_name(spelling))}
    if quantities:
        return not quantities.isdisjoint(("torque", *DRIVEN_ONLY))
    unit = re.search(r"[\[(]([^\])]+)[\])]$", bare)
    if (unit and normalise_name(unit[1]) in UNITS_OF_NO_TORQUE) or _is_raw("position", header):
        return False
    if find_trailing_unit({**UNITS["position"], **UNITS["velocity"]}, header):
        return False
    return not any(word in NO_TORQUE for word in words)


def _select_joint(label: frozenset[str], candidates: Sequence[FileColumn]) -> list[FileColumn]:
    """Select the columns of the joint with a label."""
    return [column for column in candidates if read_words(column.header).label == label]


def _match_path(position: FileColumn, candidates: Sequence[FileColumn]) -> list[FileColumn]:
    """Return the columns in the same structure or group as position."""
    path = re.split(r"[/.][^/.]*$", position.header)[0]
    return [column for column in candidates if re.split(r"[/.][^/.]*$", column.header)[0] == path]


def _find_by_words(quantity: str, headers: Sequence[str], excluded: Collection[int]) -> list[FileColumn]:
    """Find the columns with words for a quantity; their other words are the label of a joint."""
    readings = ((k, name.strip(), read_words(name.strip())) for k, name in enumerate(headers) if k not in excluded)
    return [
        FileColumn(quantity, name, k, reading.unit, reading.rank)
        for k, name, reading in readings
        if reading.quantity == quantity and not reading.is_raw
    ]


def find_labelled_columns(quantity: str, headers: Sequence[str]) -> dict[frozenset[str], str]:
    """Find the columns of a quantity, as expressions, by the label of their joint; without ambiguous ones."""
    columns = _prefer_measured(_find_by_words(quantity, headers, ()))
    labels = [read_words(column.header).label for column in columns]
    return {
        label: column.header if column.unit else add_si_unit(quantity, column.header)
        for label, column in zip(labels, columns, strict=True)
        if labels.count(label) == 1
    }


def add_si_unit(quantity: str, header: str) -> str:
    """Add the SI unit to a header without unit whose joint could be read as one: `position_rotation`, `tau_a`."""
    reads_as_unit = find_trailing_unit(UNITS[quantity] | RAW.get(quantity, {}), header)
    return f"{header}:{SI[quantity]}" if reads_as_unit else header


def _find_positions(
    headers: Sequence[str], torque: FileColumn | None, used: set[int], text_columns: Collection[int]
) -> list[FileColumn]:
    """Find columns of position by their names, else of joints by labels that torques or currents have, too.

    Without any such label, joints are those with numbers alone.
    """
    positions = _find_candidates("position", headers, used)
    if positions or len(_find_joints(headers)) > 1:
        return positions
    readings = [read_words(header.strip()) for header in ([torque.header] if torque else headers)]
    labels = {reading.label for reading in readings if reading.quantity == "torque"}
    by_words = _find_by_words("position", headers, {*used, *text_columns})
    of_joints = [column for column in by_words if read_words(column.header).label in labels]
    numbered_columns = [c for c in by_words if all(word.isdecimal() for word in read_words(c.header).label)]
    return of_joints or ([] if labels else numbered_columns)


def _drop_fractions(columns: Sequence[FileColumn], headers: Sequence[str]) -> list[FileColumn]:
    """Drop the columns of time with the fraction of the seconds in another of them."""
    fractions = {fraction.index for column in columns if (fraction := _find_fraction(column, headers))}
    return [column for column in columns if column.index not in fractions]


def _find_clocks(headers: Sequence[str], date_columns: Collection[int], used: Collection[int]) -> list[FileColumn]:
    """Find columns of dates, or else those of a clock by all words: `sim_time`, `system_time_ms`, not `cpu_time`."""
    dates = [FileColumn("time", headers[k].strip(), k, None) for k in date_columns if k not in used]
    readings = [(column, read_words(column.header)) for column in _find_by_words("time", headers, used)]
    return dates or [column for column, reading in readings if reading.is_last and reading.label <= CLOCKS]


def _find_fraction(seconds: FileColumn, headers: Sequence[str]) -> FileColumn | None:
    """Find the column with the fraction of each second: `nsecs` of `secs`, `stamp.nanosec` of `stamp.sec`."""
    stem, factor = _split_time_unit(seconds.header)
    for k, header in enumerate(headers):
        other_stem, other_factor = _split_time_unit(header)
        if factor == 1.0 and other_factor < 1.0 and other_stem == stem:
            return FileColumn("time", header.strip(), k, None, expression=Expression("", factors=(f"*{other_factor}",)))
    return None


def _split_time_unit(name: str) -> tuple[tuple[str, ...], float]:
    """Split a name into words before its unit of time, and the factor of the unit; NaN if it ends in none."""
    words = split_words(name)
    units = ((k, UNITS["time"].get("".join(words[k:]))) for k in range(len(words)))
    return next(((tuple(words[:k]), factor) for k, factor in units if factor), ((), math.nan))


def _find_moteus_unit(header: str, headers: Sequence[str]) -> str | None:
    """Return the letters of the unit of a column of a moteus log, turns or turns per second; None for others."""
    is_moteus = len(MOTEUS_REGISTERS & {normalise_name(name) for name in headers}) > 1
    return MOTEUS.get(normalise_name(header)) if is_moteus else None


def write_unit(quantity: str, unit: str) -> str:
    """Write a unit from its letters, as in messages: `revs` of a velocity is `rev/s`."""
    return {normalise_name(name): name for name in UNIT_NAMES.get(quantity, "").split(", ")}.get(unit, unit)


def add_labels(columns: dict[str, FileColumn], headers: Sequence[str], cells: Sequence[str]) -> dict[str, FileColumn]:
    """Add a column of words as `segment`, by its name and first cell, if the file has none."""
    if "segment" in columns:
        return columns
    for index, (header, cell) in enumerate(zip(headers, cells, strict=True)):
        is_word = cell.lower() not in ("true", "false", "nan", "inf") and re.match(r"[^\W\d_]{2}", cell)
        if is_word and normalise_name(_list_spellings(header)[2] or header) in LABELS:
            return {**columns, "segment": FileColumn("segment", header.strip(), index, None)}
    return columns


def guess_columns(headers: Sequence[str]) -> dict[str, str]:
    """Guess the column of each quantity, without ambiguous ones; gains may be missing."""
    guessed = {}
    for quantity in ALIASES:
        columns = _prefer_measured(_find_candidates(quantity, headers, set()))
        names = [c.header for c in columns] or [h.strip() for h in headers if _is_raw(quantity, h)]
        if len(names) == 1 or (names and quantity in FIRST_MATCHING):
            guessed[quantity] = names[0]
    return guessed


def _find_output(output: str, headers: Sequence[str]) -> str | None:
    """Return the expression of the column with a controller's output, or None."""
    for header in headers:
        if normalise_name(re.split(r"[\[(]", header)[0]) == output and output in OUTPUTS:
            unit = "" if find_trailing_unit(RAW["torque"], header) else f":{OUTPUTS[output]}"
            return f"{header.strip()}{unit}*?"
    return None


def _prefer_measured(columns: Sequence[FileColumn]) -> list[FileColumn]:
    """Return the columns of the best rank: measured before estimated before commanded."""
    best = min((column.rank for column in columns), default=None)
    return [column for column in columns if column.rank == best]


def has_column(quantity: str, headers: Sequence[str]) -> bool:
    """Return whether a column has a name of the quantity."""
    return bool(_find_candidates(quantity, headers, set()))


def _find_candidates(quantity: str, headers: Sequence[str], used: set[int]) -> list[FileColumn]:
    """Find columns of a quantity by their whole names, else by the last two parts of their paths."""
    spellings = [_list_spellings(header) for header in headers]
    for part in range(len(spellings[0]) if spellings else 0):
        matches = [(k, find_name(names[part])) for k, names in enumerate(spellings) if k not in used]
        candidates = [FileColumn(quantity, headers[k].strip(), k, *m[1:]) for k, m in matches if m and m[0] == quantity]
        if candidates:
            return candidates
    return []


def _list_spellings(header: str) -> tuple[str, ...]:
    """Return the spellings of a name: whole, without index, last and second last part of its path, and plain.

    `/joint_states/position[0]` ends in `position`, `/joint_states/position/elbow` has it before its end. The last is
    without additions of programs: `Latest: Angle (rad)`, `Angle (rad) Run #1`, `Angle in rad` and `%time`.
    """
    bare = re.sub(r"[\[(]\d+[\])]\s*$", "", header.strip())
    parts = [part for part in re.split(r"[/.]", bare) if part.strip()]
    leaf = parts[-1] if len(parts) > 1 or (parts and ("[" in header or "(" in header)) else ""
    parent = parts[-2] if len(parts) > 2 or (len(parts) == 2 and normalise_name(leaf) in VALUES) else ""
    plain = re.sub(r"\s+in\s+(\S+)$", r" (\1)", ADDITIONS.sub("", header.strip()))
    return header, bare, leaf, parent, plain


def strip_units(headers: Sequence[str]) -> dict[str, str]:
    """Return the headers by their names without units: `position_lift` of `position_lift [mm]`."""
    return {re.split(r"[\[(]", header)[0].strip(): header for header in headers}


def _find_joints(headers: Sequence[str]) -> list[str]:
    """List the joints with columns of position and torque: `elbow` of `position_elbow` and `torque_elbow`."""
    plain = strip_units(headers)
    joints = (header.removeprefix("position_") for header in plain if header.startswith("position_"))
    return [joint for joint in joints if f"torque_{joint}" in plain]


def _write_gain(quantity: str, header: str, can_find_gain: bool = True) -> tuple[str, str]:
    """Write a unit and a gain for a column, in the unit of its name; return them with the meaning of the gain."""
    if quantity != "torque":
        return f":{'counts/s' if quantity == 'velocity' else 'counts'}/4096", " with the counts of a turn"
    unit, trailing_unit = _find_header_raw_unit(header), find_trailing_unit(RAW["torque"], header)
    unit_text = f":{ {'ma': 'mA', 'mv': 'mV', '%': '%', 'percent': '%'}.get(trailing_unit or '', unit) }"
    alternative = f", or {format_setting('columns', {quantity: f'{header}{unit_text}*?'})} if known loads determine it"
    return f"{unit_text}*0.1", f" with {TORQUE_GAINS[unit]}{alternative if can_find_gain else ''}"


def _find_header_raw_unit(header: str) -> str:
    return _find_raw_unit(find_trailing_unit(RAW["torque"], header) or normalise_name(re.split(r"[\[(]", header)[0]))


def _find_raw_unit(text: str) -> str:
    """Return the unit that a gain converts to torque, `A`, `V` or `duty`, from the letters of a unit or name."""
    if text in ("v", "mv") or "volt" in text:
        return "V"
    return "duty" if text in ("%", "percent", "presentload") or "duty" in text or "pwm" in text else "A"


def _is_raw(quantity: str, header: str) -> bool:
    """Return whether a name denotes a motor current or voltage, or encoder counts."""
    names = RAW_NAMES.get(quantity, ())
    spellings = {normalise_name(header), *(normalise_name(_list_spellings(header)[part]) for part in (2, -1))} | {
        normalise_name(re.split(r"[\[(]", header)[0])
    }
    return not spellings.isdisjoint(names) or find_trailing_unit(RAW.get(quantity, {}), header) is not None


def strip_joint(quantity: str) -> str:
    """Return the quantity of `position_elbow` or `torque_elbow`, and other names unchanged."""
    return quantity.partition("_")[0] if quantity.startswith(("position_", "torque_")) else quantity


def refuse_unknown_quantity(quantity: str) -> None:
    """Refuse a word that is not a quantity."""
    try:
        find("quantity", quantity, ALIASES)
    except UnknownName as error:
        raise ColumnError(str(error)) from None


def check_columns_option(columns: object) -> None:
    """Refuse an option `columns` that is neither None nor a mapping of quantities to texts or None."""
    is_mapping = isinstance(columns, Mapping) and all(isinstance(text, str | None) for text in columns.values())
    if columns is not None and not is_mapping:
        raise TypeError(
            f"columns={quote_value(columns)}: give a dictionary of quantities, as in {{'position': 'q:deg'}}"
        )


def parse_column(quantity: str, text: str, headers: Sequence[str], can_find_gain: bool = True) -> FileColumn:
    """Find the column and conversion of a user's expression for a quantity."""
    refuse_unknown_quantity(quantity)
    names = [header.strip() for header in headers]
    raw = RAW.get(quantity, {})
    try:
        expression = _parse_name(text, names, list_unit_factors(quantity))
    except UnknownColumnError as error:
        raise ColumnError(
            f"no column is named {str(error)!r}, which is to be {quantity}, among {_list_headers(headers)}"
        ) from None
    except UnknownUnitError as error:
        unit_names = UNIT_NAMES.get(quantity, "none")
        raise ColumnError(f"unit {str(error)!r} of {quantity} is not known: use one of {unit_names}") from None
    name = expression.name
    name_units = {**UNITS[quantity], **LINEAR.get(quantity, {})}
    unit = find_trailing_unit(name_units, name) if expression.unit is None else normalise_name(expression.unit)
    is_raw = unit in raw if unit is not None else _is_raw(quantity, name)
    is_converted = any(factor[0] == "*" for factor in expression.factors)  # a ratio may include 2 pi
    if is_raw and not (is_converted or (expression.factors and expression.unit is not None)):
        gain, meaning = _write_gain(quantity, name, can_find_gain)
        example = f"{format_setting('columns', {quantity: name + gain})}{meaning}"
        raise ColumnError(f"{quantity} cannot be column {name!r} without a gain: write {example}")
    if expression.unit is None and not expression.factors:
        _refuse_other_unit(quantity, name, is_unit_known=unit is not None)
    if unit is None and is_raw and quantity == "torque":  # `current [mA]`; counts have a gain to radians
        unit = find_trailing_unit(raw, name)
    is_inferred = False
    if unit is None and not is_raw:  # the unit that the column has if it is found by its name
        alone = _find_candidates(quantity, [name], set()) or _find_by_words(quantity, [name], ())
        name_unit = alone[0].unit if alone else None
        if name_unit is None and quantity in MOTEUS:
            name_unit = _find_moteus_unit(name, names)
        if name_unit and not expression.has_factor(
            _find_factor(quantity, name_unit)
        ):  # else the user converts: `degrees*pi/180`
            unit, expression, is_inferred = name_unit, replace(expression, unit=write_unit(quantity, name_unit)), True
    if expression.is_gain_unknown and (quantity != "torque" or unit not in raw):
        raise ColumnError(f"the gain of {quantity} can be unknown only where it is a current: write torque={name}:A*?")
    offset_unit = unit if expression.offset_unit is None else normalise_name(expression.offset_unit)
    if expression.offset is not None and offset_unit in raw:
        raise ColumnError(
            f"the offset in {text.strip()!r} is added after the gain and needs a unit of its own: write it as "
            f"{expression.offset}:{UNIT_NAMES[quantity].split(',')[0]}"
        )
    return FileColumn(quantity, name, names.index(name), unit, expression=expression, is_unit_inferred=is_inferred)


def _refuse_other_unit(quantity: str, name: str, *, is_unit_known: bool) -> None:
    """Refuse a name of another quantity, or of an unknown unit, for a column that the user gives without a unit."""
    if quantity == "position" and read_words(name).quantity == "velocity":
        raise ColumnError(
            f"position cannot be column {name!r}, a velocity by its name: name a column of position, or give its unit, "
            f"as in {format_setting('columns', {quantity: f'{name}:rad'})}"
        )
    if name.endswith(PERCENT_OF_RANGE):
        bare = name.removesuffix(PERCENT_OF_RANGE)
        example = format_setting("columns", {quantity: f"{bare}:deg*0.9"})
        raise ColumnError(
            f"{quantity} cannot be column {name!r} without its range: copy LeRobot's calibration file of the arm to "
            "calibration.json in the folder of the dataset, or give half of the range in degrees over 100, as in "
            f"{example}"
        )
    if not is_unit_known and is_unscaled(name):
        example = format_setting("columns", {quantity: f"{name}*0.001"})
        meaning = f"with the {SI[quantity]} in a unit of it"
        raise ColumnError(f"{quantity} cannot be column {name!r} without a gain: write {example} {meaning}")


def is_unscaled(name: str) -> bool:
    """Return whether the last word of a name is that of values without a unit: `torque_raw`."""
    return not UNSCALED.isdisjoint(split_words(name)[-1:])


def _parse_name(text: str, names: Sequence[str], units: Mapping[str, float]) -> Expression:
    """Parse an expression; the name may lack its unit in brackets if it is unique."""
    try:
        return parse_expression(text, names, units)
    except UnknownColumnError:
        bare = [re.split(r"\s*[\[(]", name)[0] for name in names]
        expression = parse_expression(text, [name for name in bare if bare.count(name) == 1], units)
        return replace(expression, name=names[bare.index(expression.name)])


def find_trailing_unit(units: Mapping[str, float], name: str) -> str | None:
    """Return the letters of the unit at the end of a name, `Winkel [deg]` or `phi2_deg`, or None."""
    ending = re.search(r"\[([^\]]*)\]$|\(([^)]*)\)$|[\s_]([^\s_]+)$", name.strip()[-LONGEST_UNIT:])
    unit = normalise_name(next(filter(None, ending.groups()), "")) if ending else ""
    return unit if unit in units and may_be_unit(unit, name) else None


def _list_headers(headers: Sequence[str]) -> str:
    names = [quote_value(header.strip(), LONGEST_HEADER) for header in headers]
    shown_names = [name for k, name in enumerate(names) if k < 3 or len(", ".join(names[: k + 1])) < LONGEST_LIST]
    return ", ".join(shown_names + ["..."] * (len(shown_names) < len(names))) or "none"
