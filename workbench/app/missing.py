"""What a running model lacks: evidence on a time line, effects as bars that move, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from dash import Input, Output, State, html
from dash.development.base_component import Component

from estimators.online import OnlineDiagnosis
from pendulum_env.words import listing, name, number, opening
from workbench.app.following import Follower
from workbench.app.parts import button, graph
from workbench.app.session import Session
from workbench.app.stage import Bench
from workbench.mistakes import InputError
from workbench.report.figure import Figure, axis, line

COURSE = "live-evidence"
LABEL = "Evidence that the model lacks something, over time, with alarms"
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


def view() -> list[Component]:
    """The verdict, the time line, the bars, and two buttons that stay while all else moves."""
    presses = [button("Add it", "live-add", disabled=True), button("Undo", "live-undo", disabled=True)]
    return [
        html.P("", id="live-verdict", className="note", role="status"),
        graph(Figure(COURSE, LABEL, [], {}, HEIGHT), bar=False),
        html.Div(id="live-bars", className="odds"),
        html.Div(presses, className="row"),
    ]


def connect(bench: Bench) -> None:
    """Wire the buttons."""

    @bench.on(Input("live-add", "n_clicks"), given=(State("live-add", "value"),))
    def add(session: Session, _: int, shown: object) -> None:
        """The effect that the button named: another may lead by now."""
        if not isinstance(shown, str) or not shown:
            raise InputError("nothing is missing that could be added: wait for an alarm")
        _change(session, lambda follower: follower.add(shown))

    bench.buttons({"live-undo": lambda session: _change(session, Follower.undo)})


def _change(session: Session, do: Callable[[Follower], None]) -> None:
    if session.run is None:
        raise InputError("nothing runs: start a run first")
    try:
        do(session.run.follower)
    except ValueError as error:
        raise InputError(str(error)) from None


def told(said: OnlineDiagnosis, running: bool) -> tuple[Any, ...]:
    """What `OUTPUTS` show."""
    free, leader = bool(said.group), next(iter(said.group), "")
    label = f"Add {name(leader)}" if free else "Add it"
    return _verdict(said), _bars(said), label, leader, not (running and free), not (running and said.added)


def _verdict(said: OnlineDiagnosis) -> str:
    model = " + ".join(["base", *map(name, said.added)])
    if said.kind == "missing":
        word = f"missing is {listing([name(id) for id in said.group], 'or')}"
    elif said.kind == "nothing":
        word = "nothing is missing so far"
    else:
        word = "learning how the model predicts"
    error = f", error {number(said.error)} N m" if np.isfinite(said.error) else ""
    return f"Model {model}: {word}{error}."


def _bars(said: OnlineDiagnosis) -> Component | str:
    """Probabilities, of none as well; they move by their style."""
    if not said.ranking:
        return ""
    rows = [_bar("Nothing", said.none, "")]
    for one in said.ranking[:SHOWN]:
        rows.append(_bar(opening(name(one.effect)), one.probability, f"{one.gain:+.0f} ± {one.error:.0f} nat"))
    return html.Table(html.Tbody(rows))


def _bar(label: str, share: float, note: str) -> Component:
    meter = html.Span(html.I(style={"width": f"{100 * share:.0f}%"}), className="meter")
    numbers = [html.Td(text, className="number") for text in (f"{share:.2f}", note)]
    return html.Tr([html.Th(label, scope="row"), html.Td(meter), *numbers])


def course(run: Follower, time: float) -> Figure:
    """Evidence that something is missing over time, its threshold, and what happened when."""
    seen, events = np.array(run.course).reshape(-1, 2), run.events[:]
    marks = {"mode": "lines+markers", "line": {"color": "--base", "width": 2}, "marker": {"size": 5}}
    drawn = [line(seen[:, 0], np.clip(seen[:, 1], FLOOR, ROOF), "evidence", "--base", "nat", **marks)]
    threshold, end = run.said.threshold, max(time, 1.0)
    lines = [_line(0.0, end, threshold, threshold, "--muted", "dot")]
    lines += [_line(e.time, e.time, FLOOR, ROOF, "--base" if e.alarm else "--final", "solid") for e in events]
    beside: dict[str, Any] = {"showarrow": False, "xanchor": "left", "xshift": 4, "font": {"size": 11}}
    notes = [{"x": e.time, "y": ROOF * (1.0 - 0.17 * (k % 5)), "text": e.text, **beside} for k, e in enumerate(events)]
    layout = {
        "xaxis": axis("time [s]", range=[0.0, end]),
        "yaxis": axis("evidence [nat]", range=[FLOOR, ROOF]),
        "showlegend": False,
        "hovermode": False,
        "shapes": lines,
        "annotations": notes,
    }
    return Figure(COURSE, LABEL, drawn, layout, HEIGHT)


def _line(left: float, right: float, low: float, high: float, color: str, dash: str) -> dict[str, Any]:
    line = {"color": color, "width": 1.4, "dash": dash}
    return {"type": "line", "x0": left, "x1": right, "y0": low, "y1": high, "line": line}
