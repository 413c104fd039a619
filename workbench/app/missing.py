"""What a running model lacks: evidence on a time line, effects as bars that move, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from dash import Input, Output, State, html
from dash.development.base_component import Component

from estimators.online import Standing
from workbench.app.following import Event, Follower, Following
from workbench.app.parts import button
from workbench.app.session import Session
from workbench.app.stage import Bench
from workbench.mistakes import InputError
from workbench.report.figure import Figure, numbers
from workbench.report.words import listing, name, number, opening

COURSE = "live-evidence"
HEIGHT = 190  # [px]
SHOWN = 6  # effects
FLOOR, ROOF = -5.0, 60.0  # [nat], between which evidence is drawn
OUTPUTS = (
    Output("live-verdict", "children"),
    Output("live-bars", "children"),
    Output("live-add", "children"),
    Output("live-add", "value"),
    Output("live-add", "disabled"),
    Output("live-undo", "disabled"),
)


def view(plot: Callable[[str, int], Component]) -> list[Component]:
    """The verdict, the time line, the bars, and two buttons that stay while all else moves."""
    return [
        html.P("", id="live-verdict", className="note", role="status"),
        plot(COURSE, HEIGHT),
        html.Div(id="live-bars", className="odds"),
        html.Div(
            [button("Add it", "live-add", disabled=True), button("Undo", "live-undo", disabled=True)], className="row"
        ),
    ]


def connect(bench: Bench) -> None:
    """Wire the buttons."""

    @bench.on(Input("live-add", "n_clicks"), given=(State("live-add", "value"),))
    def add(session: Session, _: int, shown: object) -> None:
        """The effect that the button named: another may lead by now."""
        if not isinstance(shown, str) or not shown:
            raise InputError("nothing is missing that could be added: wait for an alarm")
        _change(session, lambda follower: follower.add(shown))

    @bench.on(Input("live-undo", "n_clicks"))
    def undo(session: Session, _: int) -> None:
        _change(session, Follower.undo)


def _change(session: Session, do: Callable[[Follower], None]) -> None:
    if session.run is None:
        raise InputError("nothing runs: start a run first")
    try:
        do(session.run.follower)
    except ValueError as error:
        raise InputError(str(error)) from None


def told(now: Following, running: bool) -> tuple[Any, ...]:
    """What `OUTPUTS` show."""
    said, free = now.said, bool(now.said.group)
    leader = said.group[0] if free else ""
    label = f"Add {name(leader)}" if free else "Add it"
    return _verdict(now), _bars(now), label, leader, not (running and free), not (running and said.added)


def _verdict(now: Following) -> str:
    said = now.said
    model = " + ".join(["base", *map(name, said.added)])
    if said.kind == "missing":
        word = f"missing is {listing([name(id) for id in said.group], 'or')}"
    elif said.kind == "nothing":
        word = "nothing is missing so far"
    else:
        word = "learning how the model predicts"
    if now.verdict.kind == "value":
        word += f"; {name(now.verdict.parameter)} has changed" if now.verdict.parameter else "; a value has changed"
    if now.verdict.kind == "structure":
        word += "; its structure has changed"
    error = f", error {number(said.error)} N m" if np.isfinite(said.error) else ""
    return f"Model {model}: {word}{error}."


def _bars(now: Following) -> Component | str:
    """Probabilities, of none as well; they move by their style."""
    said = now.said
    if not said.ranking:
        return ""
    rows = [_bar("Nothing", said.none, "")]
    rows += [_bar(opening(name(one.effect)), one.probability, _gain(one)) for one in said.ranking[:SHOWN]]
    return html.Table(html.Tbody(rows))


def _gain(one: Standing) -> str:
    return f"{one.gain:+.0f} ± {one.error:.0f} nat"


def _bar(label: str, share: float, note: str) -> Component:
    meter = html.Span(html.I(style={"width": f"{100 * share:.0f}%"}), className="meter")
    return html.Tr(
        [
            html.Th(label, scope="row"),
            html.Td(meter),
            html.Td(f"{share:.2f}", className="number"),
            html.Td(note, className="number"),
        ]
    )


def course(now: Following, time: float) -> Figure:
    """Evidence that something is missing over time, its threshold, and what happened when."""
    seen = np.array(now.course).reshape(-1, 2)
    drawn: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "x": numbers(seen[:, 0]),
            "y": numbers(np.clip(seen[:, 1], FLOOR, ROOF)),
            "line": {"color": "--base", "width": 2},
            "marker": {"size": 5},
        }
    ]
    threshold, end = now.said.threshold, max(time, 1.0)
    lines = [_line(0.0, end, threshold, threshold, "--muted", "dot")]
    lines += [_line(e.time, e.time, FLOOR, ROOF, "--base" if e.alarm else "--final", "solid") for e in now.events]
    layout = {
        "xaxis": {"title": {"text": "time [s]"}, "range": [0.0, end]},
        "yaxis": {"title": {"text": "evidence [nat]"}, "range": [FLOOR, ROOF]},
        "showlegend": False,
        "hovermode": False,
        "shapes": lines,
        "annotations": [_note(event, k) for k, event in enumerate(now.events)],
    }
    return Figure(COURSE, "Evidence that the model lacks something, over time, with alarms", drawn, layout, HEIGHT)


def _line(left: float, right: float, low: float, high: float, color: str, dash: str) -> dict[str, Any]:
    line = {"color": color, "width": 1.4, "dash": dash}
    return {"type": "line", "x0": left, "x1": right, "y0": low, "y1": high, "line": line}


def _note(event: Event, k: int) -> dict[str, Any]:
    return {"x": event.time, "y": ROOF * (1.0 - 0.17 * (k % 5)), "text": event.text, "showarrow": False} | {
        "xanchor": "left",
        "xshift": 4,
        "font": {"size": 11},
    }
