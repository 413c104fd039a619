"""The card that asks what the columns of a file mean, beside what is in them."""

from __future__ import annotations

from typing import Any

import dash
import numpy as np
from dash import ALL, MATCH, ClientsideFunction, Input, Output, State, dcc, html
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env._typing import Array
from workbench.app.mapping import ROLES, Card, Choice, units
from workbench.app.parts import SPEC, aria, button, graph, labelled, panel, table
from workbench.app.session import Session
from workbench.app.stage import Bench
from workbench.app.uploads import UNWRAP
from workbench.report.figure import Figure, axis, line, thin

COLUMN = "column"  # kind of a plot that a range is brushed in
ROWS = 4  # that are shown
POINTS = 300  # of a plot
HINTS = {  # of what is done with a column
    "time": "",
    "position": "/6 or *-1 or +90",
    "velocity": "/6 or *-1",
    "torque": "*0.091, *? or *-1",
    "reference": "/6 or *-1 or +90",
}
CALLED = {"": "as named", "A": "A: current", "V": "V: voltage", "duty": "duty: share of the supply"}


def show(card: Card, session: Session) -> Component:
    """What is in the file, and the choice of what it means."""
    known = any(one.file == card.file for one in session.state.loaded)
    seconds = card.seconds
    rows: list[tuple[Any, ...]] = []
    for k, (header, choice, values) in enumerate(
        zip(card.preview.headers, card.choices, card.preview.values, strict=True)
    ):
        if values is None:
            rows.append(
                (html.Strong(header), "no numbers", "", *_controls(card.file.name, k, header, choice, disabled=True))
            )
            continue
        first = ", ".join(f"{x + 0.0:.5g}" if np.isfinite(x) else "–" for x in values[:ROWS])
        plot = graph(_plot(k, header, values, seconds), kind=COLUMN, bar=False)
        rows.append(
            (html.Strong(header), f"{first}, …", plot, *_controls(card.file.name, k, header, choice, disabled=False))
        )
    headers = [(text, False) for text in ("Column", "First rows", "All rows", "It is", "In", "Gain, ratio, offset")]
    ends = [
        labelled(
            label,
            dcc.Input(value, type="number", id=_id(end), min=0, placeholder=empty, debounce=True),
        )
        for label, end, value, empty in (
            ("Use it from [s]", "from", card.ends[0], "first row"),
            ("to [s]", "to", card.ends[1], "last row"),
        )
    ]
    brush = "Drag over a plot to choose the range." if seconds is not None else "The range can be chosen once time is."
    return panel(
        f"What the columns of {card.file.name} mean",
        *([html.P(f"{session.plain(card.why)}.", className="why", role="alert")] if card.why else []),
        html.P(
            "Time, position and torque are needed; velocity and reference are of use. What is written in the last "
            "column is done to a column one after the other, as by --columns: a gain, a ratio, an offset. For the "
            "current, voltage or duty cycle of a motor that is its torque constant, or *? to find it from known loads. "
            f"{brush}",
            className="note",
        ),
        table(headers, rows, "Columns"),
        html.Div(ends, className="fields"),
        dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], ["unwrap"] * card.source.unwrap, id=_id("unwrap")),
        html.Div(
            [
                button("Read it again" if known else "Load it", "card-load", primary=True),
                button("Leave it as it is" if known else "Leave it out", "card-close"),
            ],
            className="row",
        ),
        className="card",
    )


def _id(what: str, k: int = 0) -> dict[str, Any]:
    """A control of the card; all by pattern, since they come and go."""
    return {"card": what, "of": k}


def _controls(file: str, k: int, header: str, choice: Choice, disabled: bool) -> tuple[Component, Component, Component]:
    roles = [{"label": "unused", "value": ""}, *({"label": role, "value": role} for role in ROLES)]
    told = dict.fromkeys(["", *units(choice.role), choice.unit])
    known = [{"label": CALLED.get(unit, unit), "value": unit} for unit in told]
    more: dict[str, Any] = {"clearable": False, "searchable": False, "disabled": disabled}
    return (
        html.Div(dcc.Dropdown(roles, choice.role, id=_id("role", k), **more), **aria(label=f"Role of {header}")),
        html.Div(dcc.Dropdown(known, choice.unit, id=_id("unit", k), **more), **aria(label=f"Unit of {header}")),
        dcc.Input(
            choice.then,
            type="text",
            id=_id("then", k),
            placeholder=HINTS.get(choice.role, ""),
            disabled=disabled or not choice.role,
            persistence=file,  # what is typed stays while this card is drawn anew
            persistence_type="memory",
        ),
    )


def _plot(k: int, header: str, values: Array, seconds: Array | None) -> Figure:
    """A column over time, over rows while there is no time."""
    x = seconds if seconds is not None and len(seconds) == len(values) else np.arange(len(values), dtype=float)
    kept = thin(np.nan_to_num(values), POINTS)
    bare = {"visible": False, "fixedrange": True}
    layout = {
        "xaxis": axis("", **bare),
        "yaxis": axis("", **bare),
        "margin": {"l": 2, "r": 2, "t": 2, "b": 2},
        "dragmode": "select" if x is seconds else False,
        "selectdirection": "h",
        "showlegend": False,
    }
    data = [line(x[kept], values[kept], header, "--train", "", hoverinfo="skip", hovertemplate=None)]
    return Figure(f"{COLUMN}-{k}", f"Column {header} over {'time' if x is seconds else 'rows'}", data, layout, 54)


def connect(bench: Bench) -> None:
    """Wire the choices, the range and the buttons."""
    role, unit, *rest = (
        ({"card": what, "of": ALL}, "value") for what in ("role", "unit", "then", "unwrap", "from", "to")
    )
    told = [State(*one) for one in rest]

    def said(card: Card, roles: list[str], units: list[str], *rest: list[Any]) -> Card:
        thens, (unwrap,), (first,), (last,) = rest
        choices = [Choice(*(text or "" for text in one)) for one in zip(roles, units, thens, strict=True)]
        return card.told(choices, bool(unwrap), (first, last))

    @bench.app.callback(
        Output("version", "data", allow_duplicate=True),
        Input(*role),
        Input(*unit),
        *told,
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
            session.act(lambda: session.consider(asked))
            return session.version

    @bench.on(Input("card-load", "n_clicks"), given=(State(*role), State(*unit), *told))
    def load(session: Session, _: int, *values: Any) -> None:
        session.answer(said(session.cards[0], *values))

    @bench.on(Input("card-close", "n_clicks"))
    def close(session: Session, _: int) -> None:
        session.let_go()

    @bench.on(Input({"do": "columns", "of": ALL}, "n_clicks"))
    def ask(session: Session, _: list[int]) -> None:
        session.ask(dash.ctx.triggered_id["of"])

    @bench.app.callback(
        Output({"card": "from", "of": ALL}, "value"),
        Output({"card": "to", "of": ALL}, "value"),
        Input({"kind": COLUMN, "of": ALL}, "selectedData"),
        prevent_initial_call=True,
    )
    def brush(_: list[Any]) -> tuple[list[float], list[float]]:
        drawn = (dash.ctx.triggered[0]["value"] or {}).get("range", {}).get("x")
        if not drawn:
            raise PreventUpdate
        first, last = sorted(map(float, drawn))
        return [round(max(first, 0.0), 3)], [round(last, 3)]

    bench.app.clientside_callback(
        ClientsideFunction("app", "draw"),
        Output({"kind": COLUMN, "of": MATCH}, "figure"),
        Input({"kind": f"{COLUMN}-{SPEC}", "of": MATCH}, "data"),
        Input("theme-now", "data"),
    )  # type: ignore[no-untyped-call]
