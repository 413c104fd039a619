"""Column assignment of a file by the user: roles, units and gains, as expressions of `--columns`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pendulum_env.errors import ColumnError
from pendulum_env.formatting import join_words
from pendulum_env.recording import RecordingError, Source
from pendulum_env.recording.columns import (
    NONE,
    guess_columns,
    has_column,
    list_unit_factors,
    parse_column,
    strip_units,
    write_unit,
)
from pendulum_env.recording.expression import NUMBER, Expression, parse_expression
from pendulum_env.recording.preview import Preview, read_preview
from pendulum_env.recording.vocabulary import ALIASES, LINEAR, OPTIONAL, SI, UNIT_NAMES
from workbench.errors import write_option

UNWRAP = "unwrap: undo jumps of a turn in position"
MIN_COLUMNS = 2  # numeric columns required: time and position
EXPRESSION = re.compile(  # an expression of `--columns` in a message
    rf"(?P<sign>-?)(?P<name>.+?)(?::(?P<unit>.+?))?(?P<conversion>(?:[*/](?:[+-]?(?:{NUMBER.pattern})|\?))*"
    rf"(?:[+-](?:{NUMBER.pattern})(?::\S+)?)?)"
)
GAIN = re.compile(rf"[+-]?(?:{NUMBER.pattern})|\?")  # a number alone is a gain


@dataclass(frozen=True)
class ColumnChoice:
    """Role, unit and conversion of one column; empty texts for an unused column."""

    role: str = ""
    unit: str = ""
    conversion: str = ""  # conversion, `*0.091` or `/6+90`; a number alone is a gain

    def write_expression(self, header: str) -> str:
        """Write the column, unit and conversion as an expression of `--columns`."""
        unit, conversion = self.unit.strip(), self.conversion.strip()
        gain = "*" if GAIN.fullmatch(conversion) else ""
        return f"{header}{f':{unit}' if unit else ''}{gain}{conversion}"

    @classmethod
    def parse(cls, role: str, expression: Expression) -> ColumnChoice:
        """Convert a parsed expression to a choice."""
        gain = "".join([*(["*-1"] if expression.is_negative else []), *expression.factors])
        offset = (expression.offset or "") + ("" if expression.offset_unit is None else f":{expression.offset_unit}")
        return cls(role, expression.unit or "", gain + offset)


def write_choice(name: str, value: object) -> str:
    """Format an argument in a message of the app: columns as choices on the card, others as on the command line."""
    if name == "unwrap":
        return f"the box “{UNWRAP}” ticked"
    if name == "fixed" and isinstance(value, Mapping):
        return f"{', '.join(f'{key}={item}' for key, item in value.items())} among the known values of Diagnose"
    if name != "columns" or not isinstance(value, Mapping):
        return write_option(name, value)
    return join_words([_describe_choice(role, text) for role, text in value.items()])


def _describe_choice(role: str, text: str) -> str:
    """Describe the choice for a role: column, unit and conversion."""
    if text == NONE or not (match := EXPRESSION.fullmatch(text)):
        return f"no column as {role}"
    unit = f" in {match['unit']}" if match["unit"] else ""
    conversion = f"{'*-1' if match['sign'] else ''}{match['conversion']}"
    return f"column {match['name']} as {role}{unit}{f' with {conversion}' if conversion else ''}"


def get_quantity(role: str) -> str:
    """Return the quantity of a role: `position` of `position_elbow`."""
    return role.partition("_")[0]


def list_units(role: str) -> list[str]:
    """List the units accepted for a column of a role."""
    quantity = get_quantity(role)
    return [*UNIT_NAMES.get(quantity, "").split(", "), *LINEAR.get(quantity, {})] if quantity in UNIT_NAMES else []


def describe_unit(role: str, text: str, headers: Sequence[str]) -> str:
    """Describe the unit of a column expression: named, assumed or after gain; empty without a unit."""
    try:
        column = parse_column(get_quantity(role), text, headers)
    except RecordingError:
        return "not clear yet"
    if column.unit is not None:
        return f"{write_unit(column.quantity, column.unit)} (named)"
    if not (unit := SI[get_quantity(role)]):
        return ""
    return f"{unit} (after gain)" if column.has_unit else f"{unit} (assumed)"


@dataclass(frozen=True, eq=False)
class ColumnCard:
    """Column assignment of one file."""

    source: Source  # file and settings; `choices` replaces its columns
    choices: tuple[ColumnChoice, ...]  # one for each column
    preview: Preview  # headers and first values of the file
    loaded_id: str = ""  # id of the loaded recording; empty for a file not loaded yet
    error: str = ""  # error of reading, a sentence; empty if the user opened the card
    joints: tuple[str, ...] = ()  # moving joints of an arm; empty for a pendulum
    is_free: bool = False  # whether the joint is undriven: torque is zero

    @classmethod
    def from_source(
        cls, source: Source, loaded_id: str = "", error: str = "", joints: tuple[str, ...] = ()
    ) -> ColumnCard:
        """Create a card with roles from the source's columns, else guessed from the headers.

        Raises RecordingError if the file cannot be read, or has fewer than `MIN_COLUMNS` numeric columns.
        """
        preview = read_preview(source.file)
        if (count := MIN_COLUMNS) > sum(values is not None for values in preview.values):
            raise RecordingError(f"{source.file}: has fewer than {count} columns of numbers: log time and position")
        is_free = source.columns.get("torque") == NONE
        card = cls(source, (), preview, loaded_id, error, joints, is_free)
        numbers = [name for name, x in zip(preview.headers, preview.values, strict=True) if x is not None]
        guessed = guess_columns(numbers)
        if joints:
            plain = strip_units(preview.headers)
            guessed = {role: plain[role] for role in card.roles if role in plain}
        chosen = {name: ColumnChoice(role) for role, name in guessed.items() if role not in source.columns}
        for role, text in source.columns.items():
            try:
                expression = parse_expression(text, preview.headers, list_unit_factors(get_quantity(role)))
            except RecordingError:
                continue  # `none`, or an error already reported by reading
            chosen[expression.name] = ColumnChoice.parse(role, expression)
        return replace(card, choices=tuple(chosen.get(header, ColumnChoice()) for header in preview.headers))

    @property
    def roles(self) -> tuple[str, ...]:
        """Return the possible roles of a column; for an arm, time and the position and torque of each joint."""
        roles = (f"{quantity}_{joint}" for joint in self.joints for quantity in ("position", "torque"))
        return ("time", *roles) if self.joints else tuple(ALIASES)

    def set_choices(self, choices: Sequence[ColumnChoice], unwrap: bool) -> ColumnCard:
        """Return the card with other choices."""
        return replace(self, choices=tuple(choices), source=replace(self.source, unwrap=unwrap))

    def fill_form(self, form: Mapping[str, Any]) -> ColumnCard:
        """Return the card with the values of the page's controls."""
        columns = range(len(self.choices))
        names = ("role", "unit", "conversion")
        choices = [ColumnChoice(*(form.get(f"{name}:{k}") or "" for name in names)) for k in columns]
        card = replace(self, is_free=bool(form.get("free:0")))
        return card.set_choices(choices, bool(form.get("unwrap:0")))

    def has_same_roles(self, other: ColumnCard) -> bool:
        """Return whether both cards have the same roles and units."""
        return [(c.role, c.unit) for c in self.choices] == [(c.role, c.unit) for c in other.choices]

    def make_source(self) -> Source:
        """Return the source with the chosen columns; raises ColumnError if two columns have the same role."""
        columns: dict[str, str] = {}
        for role in dict.fromkeys(choice.role for choice in self.choices if choice.role):
            pairs = [pair for pair in zip(self.preview.headers, self.choices, strict=True) if pair[1].role == role]
            if len(pairs) > 1:
                named = join_words([repr(header) for header, _ in pairs])
                raise ColumnError(f"{self.source.file}: columns {named} are all to be {role}: choose one")
            ((header, choice),) = pairs
            columns[role] = choice.write_expression(header)
        if self.is_free and "torque" not in columns and not self.joints:
            columns["torque"] = NONE
        unused = [q for q in OPTIONAL if not (q in columns or self.joints) and has_column(q, self.preview.headers)]
        return replace(self.source, columns=columns | dict.fromkeys(unused, NONE))
