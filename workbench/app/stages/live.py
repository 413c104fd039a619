"""Live: a pendulum that runs in real time while the estimates converge."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from dash import Dash, Input, Output, dcc, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from estimators.online import OnlineDiagnosis
from pendulum_env._typing import JSON
from pendulum_env.backends import BACKENDS
from pendulum_env.env import OWN_PLANT
from pendulum_env.physics import BASE
from pendulum_env.recording import Source, write_recording
from pendulum_env.words import estimate, listing, name, number, opening, unit
from workbench.app import live, recorder
from workbench.app.parts import KEPT, aria, button, dropdown, field, graph, labelled, panel, spec, table
from workbench.app.session import Action, Form, Session, Sessions, Stage
from workbench.mistakes import InputError
from workbench.report.figure import Figure, axis, line, segment
from workbench.report.numbers import convergence_figure, stroke

RIG = "dm1015b"  # backend that is offered where a configuration was given on the command line
NAMES = {"replay": "a recording", RIG: "the rig", "mujoco": "MuJoCo"}  # of backends
RATE = 500.0  # [Hz], of a simulated pendulum
PARAMETERS = tuple(column.name for term in BASE for column in term.columns)
PLOTS = [f"live-{k}" for k in range(len(PARAMETERS))]
EVIDENCE, LABEL = "live-evidence", "Evidence that the model lacks something, over time, with alarms"
HEIGHT = 190  # [px], of its plot
FLOOR, ROOF = -5.0, 60.0  # [nat], between which evidence is drawn


def show(session: Session) -> list[Component]:
    """Controls, the pendulum, and the estimates."""
    running = session.run is not None and session.run.running
    buttons = [
        button("Start", "live-start", primary=True),
        button("Stop", "live-stop", disabled=session.run is None),
        button("Keep as a recording", "live-keep", disabled=session.run is None),
    ]
    return [
        dcc.Interval(id="live-beat", interval=250, disabled=not running),  # [ms] between two looks
        dcc.Store(id="live-motion"),
        panel(
            "Watch it learn",
            html.P(
                "A pendulum in real time, and what the six schemes make of it sample by sample. Hide an effect from "
                "them, see how they begin to disagree, be told what is missing, and add it.",
                className="note",
            ),
            html.Div(_controls(session), className="fields"),
            html.Div(buttons, className="row"),
        ),
        html.Div(_views(), hidden=session.run is None),
    ]


def _controls(session: Session) -> list[Component]:
    """What to run."""
    backends = {id: NAMES.get(id, id) for id in BACKENDS if id != RIG or session.rig is not None}
    replays = [{"label": one.recording.name, "value": one.id} for one in session.state.loaded]
    first = replays[0]["value"] if replays else None
    backend = labelled("Backend", dropdown("live-backend", backends, "pymunk", searchable=False, **KEPT))
    replay = labelled("To replay", dropdown("live-replay", replays, first, searchable=False))
    return [backend, *recorder.fields("live-", 30), html.Div(replay, id="live-replay-field", hidden=True)]


def _views() -> list[Component]:
    """The pendulum, what is said of its model, and the estimates."""
    pendulum = panel(
        "Pendulum",
        html.Div(id="pendulum", role="img", **aria(label="The pendulum as it swings")),
        html.P("", id="live-said", className="note", role="status"),
    )
    labels = {plot: f"Estimates of {of} over time" for plot, of in zip(PLOTS, PARAMETERS, strict=True)}
    empty = [graph(Figure(plot, label, [], {}, 210), bar=False) for plot, label in labels.items()]
    plots = html.Div(empty, className="grid")
    missing = [
        html.P("", id="live-verdict", className="note", role="status"),
        graph(Figure(EVIDENCE, LABEL, [], {}, HEIGHT), bar=False),
        html.Div(id="live-bars", className="odds"),
        dcc.Input(type="hidden", id=field("live-leader")),  # which effect the button names: another may lead by now
        html.Div([button(does.title(), f"live-{does}", disabled=True) for does in ("add", "undo")], className="row"),
    ]
    return [
        html.Div([pendulum, panel("What is missing", *missing)], className="columns live"),
        panel("Estimates", plots, html.Div(id="live-table"), className="estimates"),
    ]


def figure(run: live.Run, column: int) -> Figure | None:
    """Estimates of one parameter over time, and the truth where it is known."""
    found = run.identification
    if found is None:
        return None
    drawn = convergence_figure(found, column, {id: stroke(k, id) for k, id in enumerate(found.schemes)})
    truth, shapes = run.begun.truth.get(PARAMETERS[column]), list[JSON]()
    if truth is not None:
        style = {"color": "--muted", "width": 1.2, "dash": "dot"}
        shapes.append(segment((0, 1), (truth, truth), style, xref="paper", layer="below"))
    return replace(drawn, layout=drawn.layout | {"hovermode": False, "shapes": shapes})


def _table(run: live.Run) -> Component | str:
    """Estimates of all schemes now, beside the truth where it is known."""
    found = run.identification
    if found is None:
        return ""
    model = next(iter(found.schemes.values())).model
    head = {"Scheme": False} | {f"{p} [{unit(model.estimates[p].unit)}]": True for p in PARAMETERS}
    rows: list[list[Any]] = [
        [[_key(stroke(k, id)), opening(name(id))], *(estimate(one.model.estimates[p]) for p in PARAMETERS)]
        for k, (id, one) in enumerate(found.schemes.items())
    ]
    if run.begun.truth:
        rows.append(["truth", *(number(run.begun.truth[p], 4) for p in PARAMETERS)])
    return table(head, rows, "Estimates")


def _key(line: JSON) -> Component:
    """A piece of a scheme's line."""
    kind = "dashed" if line["dash"] == "dash" else "solid"
    return html.I(className="stroke-key", style={"borderTop": f"2.5px {kind} var({line['color']})"})


def _said(run: live.Run) -> str:
    if run.trouble:
        return f"Stopped: {run.trouble.removesuffix('.')}."
    pace = "in real time" if run.pace > 0.97 else f"at {run.pace:.0%} of real time: this computer is busy"
    remark = f" · {run.begun.remark}" if run.begun.remark else ""
    return f"{run.time:.1f} s {pace}{remark}" if run.running else f"Ended after {run.time:.1f} s."


def told(said: OnlineDiagnosis, running: bool) -> tuple[Any, ...]:
    """The verdict, the bars, what the button adds, and whether it and the one that undoes are of no use."""
    leader = next(iter(said.group), "")
    label = f"Add {name(leader)}" if leader else "Add it"
    return _verdict(said), _bars(said), label, leader, not (running and leader), not (running and said.added)


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
    for one in said.ranking[:6]:  # effects
        rows.append(_bar(opening(name(one.effect)), one.probability, f"{one.gain:+.0f} ± {one.error:.0f} nat"))
    return html.Table(html.Tbody(rows))


def _bar(label: str, share: float, note: str) -> Component:
    meter = html.Span(html.I(style={"width": f"{100 * share:.0f}%"}), className="meter")
    numbers = [html.Td(text, className="number") for text in (f"{share:.2f}", note)]
    return html.Tr([html.Th(label, scope="row"), html.Td(meter), *numbers])


def course(run: live.Follower, time: float) -> Figure:
    """Evidence that something is missing over time, its threshold, and what happened when."""
    seen, events = np.array(run.course).reshape(-1, 2), run.events[:]
    marks = {"mode": "lines+markers", "line": {"color": "--base", "width": 2}, "marker": {"size": 5}}
    drawn = [line(seen[:, 0], np.clip(seen[:, 1], FLOOR, ROOF), "evidence", "--base", "nat", **marks)]
    threshold, end = run.said.threshold, max(time, 1.0)
    lines = [segment((0.0, end), (threshold, threshold), {"color": "--muted", "width": 1.4, "dash": "dot"})]
    for e in events:
        style = {"color": "--base" if e.alarm else "--final", "width": 1.4, "dash": "solid"}
        lines.append(segment((e.time, e.time), (FLOOR, ROOF), style))
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
    return Figure(EVIDENCE, LABEL, drawn, layout, HEIGHT)


def keep(session: Session) -> None:
    """Keep what the run has measured as a recording."""
    if session.run is None:
        raise InputError("nothing has run yet: start a run first")
    session.run.stop()
    file = session.place() / recorder.free_name(session.state)
    write_recording(session.run.recording(file.stem), file)
    session.load([Source(file)])


def options(session: Session, form: Form) -> list[str]:
    """Options of `record` that run what the controls say.

    Raises InputError if there is no recording to replay, or no rig.
    """
    backend, replay = form.get("live-backend"), form.get("live-replay")
    words = [f"--backend={backend}", f"--rate={RATE:g}", *recorder.options(form, "live-", form.get("clicks"))]
    if backend in OWN_PLANT:
        words = [word for word in words if not word.startswith("--effect=")]
    if backend == "replay":
        if replay is None:
            raise InputError("there is no recording to replay: load one first")
        if form["live-excitation"] in recorder.LEARNT:
            raise InputError("a replay does not follow a policy: choose another backend, or any signal")
        words.append(f"--replay={session.state.find(str(replay)).source.file}")
    if backend == RIG:
        if session.rig is None:
            raise InputError("there is no rig here: start the workbench with --config rig.toml")
        words.append(f"--config={session.rig}")
    return words


def _start(session: Session, form: Form) -> None:
    words = options(session, form)
    if session.run is not None:
        session.run.stop()
    session.run = live.Run(words, session.workers.take())


def _add(session: Session, _: str, form: Form) -> None:
    if not (effect := form.get("live-leader")):
        raise InputError("nothing is missing that could be added: wait for an alarm")
    _change(session, lambda follower: follower.add(effect))


def _change(session: Session, do: Callable[[live.Follower], None]) -> None:
    """Change the model of what runs."""
    if session.run is None:
        raise InputError("nothing runs: start a run first")
    try:
        do(session.run.follower)
    except ValueError as error:
        raise InputError(str(error)) from None


def connect(app: Dash, sessions: Sessions) -> None:
    """Wire what moves while a run does."""

    @app.callback(
        *(Output({"kind": "plot-spec", "of": plot}, "data") for plot in (*PLOTS, EVIDENCE)),
        *(Output(f"live-{part}", "children") for part in ("said", "table", "verdict", "bars")),
        Output({"do": "live-add", "of": ""}, "children"),
        Output(field("live-leader"), "value"),
        Output({"do": "live-add", "of": ""}, "disabled"),
        Output({"do": "live-undo", "of": ""}, "disabled"),
        Output("live-motion", "data"),
        Output("live-beat", "disabled"),
        Input("live-beat", "n_intervals"),
        Value("session", "data"),
    )
    def beat(_: int, id: str) -> tuple[Any, ...]:
        run = sessions.of(id).run if id else None
        if run is None:
            raise PreventUpdate
        run.watch()
        run.follow()
        drawn = [*(figure(run, k) for k in range(len(PARAMETERS))), course(run.follower, run.time)]
        specs = [spec(one) if one is not None else None for one in drawn]
        motion = {"rows": run.motion.round(4).tolist(), "running": run.running}
        return (*specs, _said(run), _table(run), *told(run.follower.said, run.running), motion, not run.running)

    @app.callback(Output("live-replay-field", "hidden"), Input(field("live-backend"), "value"))
    def has_none_to_replay(backend: str) -> bool:
        return backend != "replay"


ACTIONS: dict[str, Action] = {
    "live-start": lambda session, _, form: _start(session, form),
    "live-keep": lambda session, *_: keep(session),
    "live-add": _add,
    "live-undo": lambda session, *_: _change(session, live.Follower.undo),
}
HEADLINE = ("Live: a run of its own", "Estimates as they converge", "")
STAGE = Stage("live", "Live", show, ACTIONS, connect, needs_model=False, headline=HEADLINE)
