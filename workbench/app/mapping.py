"""What a person says of a file's columns: roles, units and gains, as expressions of the command line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.arms.recording import without_units
from pendulum_env.recording import RecordingError, Source
from pendulum_env.recording.columns import UNUSED, is_told, named_column
from pendulum_env.recording.expression import NUMBER, Expression, letters, parse
from pendulum_env.recording.preview import Preview, preview
from pendulum_env.recording.record import ColumnError
from pendulum_env.recording.vocabulary import ALIASES, LINEAR, OPTIONAL, RAW, SI, TOLD, UNITS
from pendulum_env.words import listing

ROLES = tuple(ALIASES)
NEEDED = 3  # columns with numbers: time, position and torque
PLAIN = re.compile(rf"[+-]?(?:{NUMBER.pattern})|\?")  # what is written alone is a gain
Ends = tuple[float | None, float | None]  # of a range [s] from the first row; None where it goes to the first or last


@dataclass(frozen=True)
class Choice:
    """What is said of one column: its role, unit and what is done with it; empty where nothing is."""

    role: str = ""
    unit: str = ""
    then: str = ""  # `*0.091`, `/6+90`; a number alone is a gain

    def expression(self, header: str) -> str:
        """The same in one line, as on the command line."""
        unit, then = self.unit.strip(), self.then.strip()
        gain = "*" if PLAIN.fullmatch(then) else ""
        return f"{header}{f':{unit}' if unit else ''}{gain}{then}"

    @classmethod
    def of(cls, role: str, told: Expression) -> Choice:
        """What an expression says of its column."""
        gain = "".join([*(["*-1"] if told.negative else []), *told.factors])
        offset = (told.offset or "") + ("" if told.offset_unit is None else f":{told.offset_unit}")
        return cls(role, told.unit or "", gain + offset)


def quantity(role: str) -> str:
    """What a role measures: `position` of `position_elbow`."""
    return role.partition("_")[0]


def understood(role: str, text: str, headers: Sequence[str]) -> str:
    """How the unit of an expression's column is understood, in words; empty where there is none."""
    try:
        column = named_column(quantity(role), text, headers)
    except RecordingError:
        return "not clear yet"
    if column.unit is not None:
        written = {letters(unit): unit for unit in units(role)}
        return f"{written.get(column.unit, column.unit)} (named)"
    if not (unit := SI[quantity(role)]):
        return ""
    return f"{unit} (after gain)" if column.is_unit_told else f"{unit} (assumed)"


def units(role: str) -> list[str]:
    """Units that a column of a role may be in."""
    what = quantity(role)
    return [*TOLD.get(what, "").split(", "), *LINEAR.get(what, {})] if what in TOLD else []


@dataclass(frozen=True, eq=False)
class Card:
    """A file whose columns a person is asked about.

    Attributes:
        source: how it is to be read; its columns and range are those of `choices` and `ends` instead.
        choices: what is said of each column.
        preview: what is in the file.
        ends: of the range to use.
        known: id of the recording that it is of; empty while that waits for an answer.
        why: what is wrong with it, in a sentence; empty if a person asked to see it.
        joints: of the arm that it is of; none of a pendulum.
    """

    source: Source
    choices: tuple[Choice, ...]
    preview: Preview
    ends: Ends = (None, None)
    known: str = ""
    why: str = ""
    joints: tuple[str, ...] = ()

    @property
    def roles(self) -> tuple[str, ...]:
        """What a column may be: of an arm, a position or torque of one of its joints."""
        own = (f"{what}_{joint}" for joint in self.joints for what in ("position", "torque"))
        return ("time", *own) if self.joints else ROLES

    @classmethod
    def of(cls, source: Source, known: str = "", why: str = "", joints: tuple[str, ...] = ()) -> Card:
        """Look at a file, beginning with what is said of it or what the names of its columns tell.

        Raises:
            RecordingError: if it cannot be read, or has too few columns to choose from.
        """
        shown = preview(source.file)
        if sum(values is not None for values in shown.values) < NEEDED:
            raise RecordingError(f"{source.file}: has fewer than {NEEDED} columns of numbers: nothing can be chosen")
        card = cls(source, (), shown, source.range or (None, None), known, why, joints)
        return replace(card, choices=_choices(shown, source.columns, card.guessed))

    @property
    def guessed(self) -> dict[str, str]:
        """Likely column by role."""
        if not self.joints:
            return self.preview.guessed
        plain = without_units(self.preview.headers)
        return {role: plain[role] for role in self.roles if role in plain}

    def told(self, choices: Sequence[Choice], unwrap: bool, ends: Ends) -> Card:
        """The card with other choices."""
        return replace(self, choices=tuple(choices), source=replace(self.source, unwrap=unwrap), ends=ends)

    @property
    def _said(self) -> list[tuple[str, str, str]]:
        """Role, name and expression of each column that has a role."""
        pairs = zip(self.preview.headers, self.choices, strict=True)
        return [(choice.role, header, choice.expression(header)) for header, choice in pairs if choice.role]

    @property
    def columns(self) -> Mapping[str, str]:
        """What is said, by quantity, as `read_recording` takes it.

        Raises:
            ColumnError: if two columns have the same role.
        """
        columns = {role: expression for role, _, expression in self._said}
        for role in columns:
            headers = [repr(header) for other, header, _ in self._said if other == role]
            if len(headers) > 1:
                raise ColumnError(f"{self.source.file}: columns {listing(headers)} are all to be {role}: choose one")
        others = [q for q in OPTIONAL if not (q in columns or self.joints) and is_told(q, self.preview.headers)]
        return columns | dict.fromkeys(others, UNUSED)

    def asked(self) -> Source:
        """The source as the choices have it.

        Raises:
            ColumnError: if two columns have the same role, or one has to be named yet.
            RecordingError: if the range is none.
        """
        first, last = self.ends
        chosen, seconds = None, self.seconds
        if seconds is not None and not (first is None and last is None):
            first = 0.0 if first is None else first
            last = np.floor(np.nanmax(seconds)) + 1.0 if last is None else last
            if not 0 <= first < last:
                raise RecordingError(
                    f"{self.source.file}: range is {first:g} to {last:g} s: let it end after it begins"
                )
            chosen = (float(first), float(last))
        return replace(self.source, columns=self.columns, range=chosen)

    @cached_property
    def seconds(self) -> Array | None:
        """Time from the first row on [s] (N,), None where no column is chosen for it."""
        told = [expression for role, _, expression in self._said if role == "time"]
        return self.preview.seconds(told[0]) if told else None


def _choices(shown: Preview, columns: Mapping[str, str], guessed: Mapping[str, str]) -> tuple[Choice, ...]:
    """What is said of columns, else what their names tell."""
    chosen = {name: Choice(role) for role, name in guessed.items() if role not in columns}
    for role, text in columns.items():
        what = quantity(role)
        known = {**UNITS[what], **RAW.get(what, {}), **LINEAR.get(what, {})}
        try:
            told = parse(text, shown.headers, known)
        except RecordingError:
            continue  # `unused`, or a mistake that reading has told of
        chosen[told.name] = Choice.of(role, told)
    return tuple(chosen.get(header, Choice()) for header in shown.headers)
