"""The card that asks what the columns of a file mean: roles, units and gains, as expressions of the command line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from dash import dcc, html
from dash.development.base_component import Component

from pendulum_env._typing import Array
from pendulum_env.arms.columns import strip_units
from pendulum_env.errors import ColumnError
from pendulum_env.formatting import join_words
from pendulum_env.recording import RecordingError, Source
from pendulum_env.recording.columns import NONE, is_told, parse_column
from pendulum_env.recording.expression import NUMBER, Expression, normalise_name, parse_expression
from pendulum_env.recording.preview import Preview, read_preview
from pendulum_env.recording.vocabulary import ALIASES, LINEAR, OPTIONAL, RAW, SI, TOLD, UNITS
from pendulum_env.thinning import thin
from workbench.app.parts import UNWRAP, label_control, make_aria, make_button, make_graph, make_panel, make_table
from workbench.figure import Figure, axis, line

NEEDED = 2  # columns with numbers: time and position
PLAIN = re.compile(rf"[+-]?(?:{NUMBER.pattern})|\?")  # what is written alone is a gain
ASKED = "Time and position are needed, and torque if anything drives the joint; velocity and reference are of use."
FREE = "Nothing drives the joint: torque is zero"
ASKED_OF_ARM = (
    "Time, and position and torque of each joint are needed: on the side of the joint, with the torque that holds the "
    "links up. What was logged of a motor before its gear has the ratio in the last column, a current its gain."
)
HINTS = {  # of what is done with a column
    "time": "*0.001",
    "position": "/6 or *-1 or +90",
    "velocity": "/6 or *-1",
    "torque": "*0.091, *? or *-1",
    "reference": "/6 or *-1 or +90",
}
CALLED = {"A": "A: current", "V": "V: voltage", "duty": "duty: share of the supply"}
TimeRange = tuple[
    float | None, float | None
]  # of a range [s] from the first row; None where it goes to the first or last


@dataclass(frozen=True)
class ColumnChoice:
    """Choice for one column: role, unit and conversion; empty without a choice."""

    role: str = ""
    unit: str = ""
    then: str = ""  # `*0.091`, `/6+90`; a number alone is a gain

    def write_expression(self, header: str) -> str:
        """Return the choice in one line, as on the command line."""
        unit, then = self.unit.strip(), self.then.strip()
        gain = "*" if PLAIN.fullmatch(then) else ""
        return f"{header}{f':{unit}' if unit else ''}{gain}{then}"

    @classmethod
    def of(cls, role: str, told: Expression) -> ColumnChoice:
        """Parse an expression into a choice."""
        gain = "".join([*(["*-1"] if told.negative else []), *told.factors])
        offset = (told.offset or "") + ("" if told.offset_unit is None else f":{told.offset_unit}")
        return cls(role, told.unit or "", gain + offset)


def get_quantity(role: str) -> str:
    """Return the quantity of a role: `position` of `position_elbow`."""
    return role.partition("_")[0]


def list_units(role: str) -> list[str]:
    """List the units that a column of a role may be in."""
    what = get_quantity(role)
    return [*TOLD.get(what, "").split(", "), *LINEAR.get(what, {})] if what in TOLD else []


def describe_unit(role: str, text: str, headers: Sequence[str]) -> str:
    """Describe the unit of the column of an expression; empty without a unit."""
    try:
        column = parse_column(get_quantity(role), text, headers)
    except RecordingError:
        return "not clear yet"
    if column.unit is not None:
        written = {normalise_name(unit): unit for unit in list_units(role)}
        return f"{written.get(column.unit, column.unit)} (named)"
    if not (unit := SI[get_quantity(role)]):
        return ""
    return f"{unit} (after gain)" if column.is_unit_told else f"{unit} (assumed)"


@dataclass(frozen=True, eq=False)
class ColumnCard:
    """A file whose columns a person is asked about."""

    source: Source  # how it is to be read; its columns and range are those of `choices` and `ends` instead
    choices: tuple[ColumnChoice, ...]  # what is said of each column
    preview: Preview  # what is in the file
    ends: TimeRange = (None, None)  # of the range to use
    known: str = ""  # id of the recording that it is of; empty while that waits for an answer
    why: str = ""  # what is wrong with it, in a sentence; empty if a person asked to see it
    joints: tuple[str, ...] = ()  # of the arm that it is of; none of a pendulum
    is_free: bool = False  # whether nothing drives the joint, so that a missing torque is zero

    @classmethod
    def of(cls, source: Source, known: str = "", why: str = "", joints: tuple[str, ...] = ()) -> ColumnCard:
        """Look at a file, beginning with what is said of it or what the names of its columns tell.

        Raises RecordingError if it cannot be read, or has too few columns to choose from.
        """
        shown = read_preview(source.file)
        if sum(values is not None for values in shown.values) < NEEDED:
            raise RecordingError(f"{source.file}: has fewer than {NEEDED} columns of numbers: nothing can be chosen")
        is_free = source.columns.get("torque") == NONE
        card = cls(source, (), shown, source.range or (None, None), known, why, joints, is_free)
        guessed = shown.guessed
        if joints:
            plain = strip_units(shown.headers)
            guessed = {role: plain[role] for role in card.roles if role in plain}
        said = {name: ColumnChoice(role) for role, name in guessed.items() if role not in source.columns}
        for role, text in source.columns.items():
            what = get_quantity(role)
            try:
                told = parse_expression(
                    text, shown.headers, {**UNITS[what], **RAW.get(what, {}), **LINEAR.get(what, {})}
                )
            except RecordingError:
                continue  # `none`, or a mistake that reading has told of
            said[told.name] = ColumnChoice.of(role, told)
        return replace(card, choices=tuple(said.get(header, ColumnChoice()) for header in shown.headers))

    @property
    def roles(self) -> tuple[str, ...]:
        """List the possible roles of a column; for an arm, positions and torques of its joints."""
        own = (f"{what}_{joint}" for joint in self.joints for what in ("position", "torque"))
        return ("time", *own) if self.joints else tuple(ALIASES)

    def set_choices(self, choices: Sequence[ColumnChoice], unwrap: bool, ends: TimeRange) -> ColumnCard:
        """Return the card with other choices."""
        return replace(self, choices=tuple(choices), source=replace(self.source, unwrap=unwrap), ends=ends)

    def fill_form(self, form: Mapping[str, Any]) -> ColumnCard:
        """Return the card as the controls of the page have it."""
        columns = range(len(self.choices))
        choices = [ColumnChoice(*(form.get(f"{what}:{k}") or "" for what in ("role", "unit", "then"))) for k in columns]
        free = replace(self, is_free=bool(form.get("free:0")))
        return free.set_choices(choices, bool(form.get("unwrap:0")), (form.get("from:0"), form.get("to:0")))

    def is_as(self, other: ColumnCard) -> bool:
        """Return whether another card has the same roles and units."""
        return [(one.role, one.unit) for one in self.choices] == [(one.role, one.unit) for one in other.choices]

    def make_source(self) -> Source:
        """Return the source as the choices have it.

        Raises ColumnError if two columns have the same role, or one has to be named yet, and RecordingError if the
        range is none.
        """
        columns: dict[str, str] = {}
        for role in dict.fromkeys(choice.role for choice in self.choices if choice.role):
            headers = [header for header, choice in self._pairs if choice.role == role]
            if len(headers) > 1:
                named = join_words(list(map(repr, headers)))
                raise ColumnError(f"{self.source.file}: columns {named} are all to be {role}: choose one")
            columns[role] = self._find_expression(role) or ""
        if self.is_free and "torque" not in columns and not self.joints:
            columns["torque"] = NONE
        others = [q for q in OPTIONAL if not (q in columns or self.joints) and is_told(q, self.preview.headers)]
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
        return replace(self.source, columns=columns | dict.fromkeys(others, NONE), range=chosen)

    @cached_property
    def seconds(self) -> Array | None:
        """Time from the first row on [s] (N,), None where no column is chosen for it."""
        told = self._find_expression("time")
        return None if told is None else self.preview.read_seconds(told)

    @property
    def _pairs(self) -> list[tuple[str, ColumnChoice]]:
        return list(zip(self.preview.headers, self.choices, strict=True))

    def _find_expression(self, role: str) -> str | None:
        """Return the expression of the column with a role."""
        return next((choice.write_expression(header) for header, choice in self._pairs if choice.role == role), None)


def show(card: ColumnCard) -> Component:
    """Render the content of the file, and the choices of its columns."""
    ends = [
        label_control(label, dcc.Input(value, type="number", id=_make_id(end), min=0, placeholder=empty, debounce=True))
        for label, end, value, empty in (
            ("Use it from [s]", "from", card.ends[0], "first row"),
            ("to [s]", "to", card.ends[1], "last row"),
        )
    ]
    return make_panel(
        f"What the columns of {card.source.file.name} mean",
        *([html.P(f"{card.why}.", className="why", role="alert")] if card.why else []),
        html.P(
            f"{ASKED_OF_ARM if card.joints else ASKED} What is written in the last "
            "column is done to a column one after the other, as by --columns: a gain, a ratio, an offset. For the "
            "current, voltage or duty cycle of a motor that is its torque constant"
            f"{'' if card.joints else ', or *? to find it from known loads'}.",
            className="note",
        ),
        make_table(
            dict.fromkeys(("Column", "First rows", "All rows", "It is", "In", "Gain, ratio, offset"), False),
            [_make_row(card, k) for k in range(len(card.choices))],
            "Columns",
        ),
        html.Div(ends, className="fields"),
        dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], ["unwrap"] * card.source.unwrap, id=_make_id("unwrap")),
        *(
            []
            if card.joints
            else [dcc.Checklist([{"label": FREE, "value": "free"}], ["free"] * card.is_free, id=_make_id("free"))]
        ),
        html.Div(
            [
                make_button("Read it again" if card.known else "Load it", "card-load", primary=True),
                make_button("Leave it as it is" if card.known else "Leave it out", "card-close"),
            ],
            className="row",
        ),
        className="card",
    )


def _make_id(what: str, k: int = 0) -> dict[str, Any]:
    """Make a control of the card; all by pattern, since they come and go."""
    return {"field": what, "of": k}


def _make_row(card: ColumnCard, k: int) -> tuple[Any, ...]:
    """Make the row of a column: its content, and the choice of its meaning."""
    header, choice, values = card.preview.headers[k], card.choices[k], card.preview.values[k]
    first, plot = "no numbers", None
    if values is not None:
        first = ", ".join(f"{x + 0.0:.5g}" if np.isfinite(x) else "–" for x in values[:4]) + ", …"  # that are shown
        plot = make_graph(_plot(k, header, values, card.seconds), bar=False)
    roles = {"": "unused"} | {role: role for role in card.roles}
    unsaid = replace(choice, unit="").write_expression(header)
    unit = (describe_unit(choice.role, unsaid, card.preview.headers) if choice.role else "") or "–"
    known = {"": unit} | {one: CALLED.get(one, one) for one in [*list_units(choice.role), choice.unit] if one}
    more: dict[str, Any] = {"clearable": False, "searchable": False, "disabled": values is None}
    then = dcc.Input(
        choice.then,
        type="text",
        id=_make_id("then", k),
        placeholder=HINTS.get(get_quantity(choice.role), ""),
        disabled=values is None or not choice.role,
        persistence=card.source.file.name,  # what is typed stays while this card is drawn anew
        persistence_type="memory",
    )
    return (
        html.Strong(header),
        first,
        plot,
        html.Div(
            dcc.Dropdown(roles, choice.role, id=_make_id("role", k), **more), **make_aria(label=f"Role of {header}")
        ),
        html.Div(
            dcc.Dropdown(known, choice.unit, id=_make_id("unit", k), **more), **make_aria(label=f"Unit of {header}")
        ),
        then,
    )


def _plot(k: int, header: str, values: Array, seconds: Array | None) -> Figure:
    """Plot a column over time, over rows while there is no time."""
    x = seconds if seconds is not None and len(seconds) == len(values) else np.arange(len(values), dtype=float)
    kept = thin(np.nan_to_num(values), 300)  # of a plot
    bare = axis("", visible=False, fixedrange=True)
    layout = {
        "xaxis": bare,
        "yaxis": bare,
        "margin": {"l": 2, "r": 2, "t": 2, "b": 2},
        "dragmode": False,
        "showlegend": False,
    }
    data = [line(x[kept], values[kept], header, "--train", "", hoverinfo="skip", hovertemplate=None)]
    return Figure(f"column-{k}", f"Column {header} over {'time' if x is seconds else 'rows'}", data, layout, 54)
