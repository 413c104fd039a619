"""Live: a pendulum that runs in real time while the estimates converge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dash import Input, Output, dcc, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env._typing import JSON
from pendulum_env.backends import BACKENDS
from pendulum_env.env import OWN_PLANT
from pendulum_env.physics import BASE
from pendulum_env.recording import Source, write_recording
from pendulum_env.words import estimate, name, number, opening, unit
from workbench.app import live, missing, recorder
from workbench.app.parts import (
    KEPT,
    aria,
    button,
    dropdown,
    graph,
    labelled,
    panel,
    run_fields,
    spec,
    table,
)
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.mistakes import InputError
from workbench.report.figure import Figure
from workbench.report.sections.schemes import convergence_figure, stroke

RIG = "dm1015b"  # backend that is offered where a configuration was given on the command line
NAMES = {"replay": "a recording", RIG: "the rig", "mujoco": "MuJoCo"}  # of backends
RATE = 500.0  # [Hz], of a simulated pendulum
BEAT = 250  # [ms] between two looks
PARAMETERS = tuple(column.name for term in BASE for column in term.columns)
FORM = ("backend", "replay", *recorder.FORM)  # controls, in the order of `options`
PLOTS = [f"live-{k}" for k in range(len(PARAMETERS))]


def show(session: Session) -> list[Component]:
    """Controls, the pendulum, and the estimates."""
    running = session.run is not None and session.run.running
    buttons = [
        button("Start", "live-start", primary=True),
        button("Stop", "live-stop", disabled=session.run is None),
        button("Keep as a recording", "live-keep", disabled=session.run is None),
    ]
    return [
        dcc.Interval(id="live-beat", interval=BEAT, disabled=not running),
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
    return [
        labelled("Backend", dropdown("live-backend", backends, "pymunk", searchable=False, **KEPT)),
        *run_fields("live-", 30),
        html.Div(
            labelled("To replay", dropdown("live-replay", replays, first, searchable=False)),
            id="live-replay-field",
            hidden=True,
        ),
    ]


def _views() -> list[Component]:
    """The pendulum, what is said of its model, and the estimates."""
    pendulum = panel(
        "Pendulum",
        html.Div(id="pendulum", role="img", **aria(label="The pendulum as it swings")),
        html.P("", id="live-said", className="note", role="status"),
    )
    empty = [
        Figure(plot, f"Estimates of {of} over time", [], {}, 210) for plot, of in zip(PLOTS, PARAMETERS, strict=True)
    ]
    plots = html.Div([graph(one, bar=False) for one in empty], className="grid")
    return [
        html.Div([pendulum, panel("What is missing", *missing.view())], className="columns live"),
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
        place = {"xref": "paper", "x0": 0, "x1": 1, "y0": truth, "y1": truth, "layer": "below"}
        shapes.append({"type": "line", "line": style, **place})
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


def connect(bench: Bench) -> None:
    """Wire start, stop, and the beat."""
    _connect_beat(bench)
    missing.connect(bench)

    @bench.on(Input("live-start", "n_clicks"), given=tuple(Value(f"live-{name}", "value") for name in FORM))
    def start(session: Session, seed: int, *chosen: Any) -> None:
        words = options(session, *chosen, seed)
        if session.run is not None:
            session.run.stop()
        session.run = live.Run(words, session.workers.take())

    bench.buttons({"live-keep": keep})
    bench.buttons({"live-stop": Session.halt}, urgent=True)  # a motor stops whenever it is told to

    @bench.app.callback(Output("live-replay-field", "hidden"), Input("live-backend", "value"))
    def has_none_to_replay(backend: str) -> bool:
        return backend != "replay"


def keep(session: Session) -> None:
    """Keep what the run has measured as a recording."""
    if session.run is None:
        raise InputError("nothing has run yet: start a run first")
    session.run.stop()
    file = session.place() / recorder.free_name(session.state)
    write_recording(session.run.recording(file.stem), file)
    session.load([Source(file)])


def options(session: Session, backend: str, replay: str | None, *torque: Any) -> list[str]:
    """Options of `record` that run what the controls say.

    Raises:
        InputError: if there is no recording to replay, or no rig.
    """
    words = [f"--backend={backend}", f"--rate={RATE:g}", *recorder.options(*torque)]
    if backend in OWN_PLANT:
        words = [word for word in words if not word.startswith("--effect=")]
    if backend == "replay":
        if replay is None:
            raise InputError("there is no recording to replay: load one first")
        if torque[0] in recorder.LEARNT:
            raise InputError("a replay does not follow a policy: choose another backend, or any signal")
        words.append(f"--replay={session.state.find(str(replay)).source.file}")
    if backend == RIG:
        if session.rig is None:
            raise InputError("there is no rig here: start the workbench with --config rig.toml")
        words.append(f"--config={session.rig}")
    return words


def _connect_beat(bench: Bench) -> None:
    """Wire what moves while a run does."""

    @bench.app.callback(
        *(Output({"kind": "plot-spec", "of": plot}, "data") for plot in (*PLOTS, missing.COURSE)),
        Output("live-motion", "data"),
        Output("live-said", "children"),
        Output("live-table", "children"),
        *missing.OUTPUTS,
        Output("live-beat", "disabled"),
        Input("live-beat", "n_intervals"),
        Value("session", "data"),
    )
    def beat(_: int, id: str) -> tuple[Any, ...]:
        run = bench.sessions.of(id).run if id else None
        if run is None:
            raise PreventUpdate
        run.watch()
        drawn = [*(figure(run, k) for k in range(len(PARAMETERS))), missing.course(run.follower, run.time)]
        specs = [spec(one) if one is not None else None for one in drawn]
        motion = {"rows": run.motion.round(4).tolist(), "running": run.running}
        said = missing.told(run.follower.said, run.running)
        return (*specs, motion, _said(run), _table(run), *said, not run.running)


HEADLINE = ("Live: a run of its own", "Estimates as they converge", "")
STAGE = Stage("live", "Live", show, connect, needs_model=False, headline=HEADLINE)
