"""The card that asks what the columns of a file mean, beside what is in them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import dash
import numpy as np
from dash import ALL, Input, Output, State, dcc, html
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env._typing import Array
from workbench.app.mapping import Card, Choice, quantity, understood, units
from workbench.app.parts import UNWRAP, aria, button, graph, labelled, panel, table
from workbench.app.session import Session
from workbench.app.stage import Bench
from workbench.report.figure import Figure, axis, line, thin

COLUMN = "column"  # kind of a plot that a range is brushed in
NEEDED = "Time, position and torque are needed; velocity and reference are of use."
NEEDED_OF_ARM = (
    "Time, and position and torque of each joint are needed: on the side of the joint, with the torque that holds the "
    "links up. What was logged of a motor before its gear has the ratio in the last column, a current its gain."
)
ROWS = 4  # that are shown
POINTS = 300  # of a plot
HINTS = {  # of what is done with a column
    "time": "*0.001",
    "position": "/6 or *-1 or +90",
    "velocity": "/6 or *-1",
    "torque": "*0.091, *? or *-1",
    "reference": "/6 or *-1 or +90",
}
CALLED = {"A": "A: current", "V": "V: voltage", "duty": "duty: share of the supply"}


def show(card: Card) -> Component:
    """What is in the file, and the choice of what it means."""
    name, seconds = card.source.file.name, card.seconds
    brush = "Drag over a plot to choose the range." if seconds is not None else "The range can be chosen once time is."
    ends = [
        labelled(label, dcc.Input(value, type="number", id=_id(end), min=0, placeholder=empty, debounce=True))
        for label, end, value, empty in (
            ("Use it from [s]", "from", card.ends[0], "first row"),
            ("to [s]", "to", card.ends[1], "last row"),
        )
    ]
    return panel(
        f"What the columns of {name} mean",
        *([html.P(f"{card.why}.", className="why", role="alert")] if card.why else []),
        html.P(
            f"{NEEDED_OF_ARM if card.joints else NEEDED} What is written in the last "
            "column is done to a column one after the other, as by --columns: a gain, a ratio, an offset. For the "
            "current, voltage or duty cycle of a motor that is its torque constant, or *? to find it from known loads. "
            f"{brush}",
            className="note",
        ),
        table(
            dict.fromkeys(("Column", "First rows", "All rows", "It is", "In", "Gain, ratio, offset"), False),
            [_row(card, k, seconds) for k in range(len(card.choices))],
            "Columns",
        ),
        html.Div(ends, className="fields"),
        dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], ["unwrap"] * card.source.unwrap, id=_id("unwrap")),
        html.Div(
            [
                button("Read it again" if card.known else "Load it", "card-load", primary=True),
                button("Leave it as it is" if card.known else "Leave it out", "card-close"),
            ],
            className="row",
        ),
        className="card",
    )


def _id(what: str, k: int = 0) -> dict[str, Any]:
    """A control of the card; all by pattern, since they come and go."""
    return {"card": what, "of": k}


def _row(card: Card, k: int, seconds: Array | None) -> tuple[Any, ...]:
    """A column: what is in it, and the choice of what it means."""
    header, choice, values = card.preview.headers[k], card.choices[k], card.preview.values[k]
    first, plot = "no numbers", None
    if values is not None:
        first = ", ".join(f"{x + 0.0:.5g}" if np.isfinite(x) else "–" for x in values[:ROWS]) + ", …"
        plot = graph(_plot(k, header, values, seconds), kind=COLUMN, bar=False)
    roles = {"": "unused"} | {role: role for role in card.roles}
    known = {"": _unsaid(card, k)} | {
        unit: CALLED.get(unit, unit) for unit in [*units(choice.role), choice.unit] if unit
    }
    more: dict[str, Any] = {"clearable": False, "searchable": False, "disabled": values is None}
    then = dcc.Input(
        choice.then,
        type="text",
        id=_id("then", k),
        placeholder=HINTS.get(quantity(choice.role), ""),
        disabled=values is None or not choice.role,
        persistence=card.source.file.name,  # what is typed stays while this card is drawn anew
        persistence_type="memory",
    )
    return (
        html.Strong(header),
        first,
        plot,
        html.Div(dcc.Dropdown(roles, choice.role, id=_id("role", k), **more), **aria(label=f"Role of {header}")),
        html.Div(dcc.Dropdown(known, choice.unit, id=_id("unit", k), **more), **aria(label=f"Unit of {header}")),
        then,
    )


def _unsaid(card: Card, k: int) -> str:
    """How a column's unit is understood while nobody says it."""
    choice, header = card.choices[k], card.preview.headers[k]
    text = replace(choice, unit="").expression(header)
    return (understood(choice.role, text, card.preview.headers) if choice.role else "") or "–"


def _plot(k: int, header: str, values: Array, seconds: Array | None) -> Figure:
    """A column over time, over rows while there is no time."""
    x = seconds if seconds is not None and len(seconds) == len(values) else np.arange(len(values), dtype=float)
    kept = thin(np.nan_to_num(values), POINTS)
    bare = axis("", visible=False, fixedrange=True)
    layout = {
        "xaxis": bare,
        "yaxis": bare,
        "margin": {"l": 2, "r": 2, "t": 2, "b": 2},
        "dragmode": "select" if x is seconds else False,
        "selectdirection": "h",
        "showlegend": False,
    }
    data = [line(x[kept], values[kept], header, "--train", "", hoverinfo="skip", hovertemplate=None)]
    return Figure(f"{COLUMN}-{k}", f"Column {header} over {'time' if x is seconds else 'rows'}", data, layout, 54)


def connect(bench: Bench) -> None:
    """Wire the choices, the range and the buttons."""
    every = [({"card": what, "of": ALL}, "value") for what in ("role", "unit", "then", "unwrap", "from", "to")]

    def said(card: Card, roles: list[str], units: list[str], *rest: list[Any]) -> Card:
        thens, (unwrap,), (first,), (last,) = rest
        choices = [Choice(*(text or "" for text in one)) for one in zip(roles, units, thens, strict=True)]
        return card.told(choices, bool(unwrap), (first, last))

    @bench.app.callback(
        Output("version", "data", allow_duplicate=True),
        *(Input(*one) for one in every[:2]),
        *(State(*one) for one in every[2:]),
        State("session", "data"),
        prevent_initial_call=True,
    )
    def choose(*values: Any) -> int:
        session = bench.sessions.of(values[-1])
        with session.lock:
            card = next(iter(session.cards), None)
            if card is None or len(values[0]) != len(card.choices):
                raise PreventUpdate
            asked = said(card, *values[:-1])
            if [(c.role, c.unit) for c in asked.choices] == [(c.role, c.unit) for c in card.choices]:
                raise PreventUpdate  # controls that have just appeared
            session.act(lambda: setattr(session, "cards", (asked, *session.cards[1:])))
            return session.version

    @bench.on(Input("card-load", "n_clicks"), given=tuple(State(*one) for one in every))
    def load(session: Session, _: int, *values: Any) -> None:
        session.answer(said(session.cards[0], *values))

    bench.buttons({"card-close": lambda session: setattr(session, "cards", session.cards[1:])})
    bench.each({"columns": Session.ask})

    @bench.app.callback(
        Output(*every[4]),
        Output(*every[5]),
        Input({"kind": COLUMN, "of": ALL}, "selectedData"),
        prevent_initial_call=True,
    )
    def brush(_: list[Any]) -> tuple[list[float], list[float]]:
        drawn = (dash.ctx.triggered[0]["value"] or {}).get("range", {}).get("x")
        if not drawn:
            raise PreventUpdate
        first, last = sorted(map(float, drawn))
        return [round(max(first, 0.0), 3)], [round(last, 3)]
