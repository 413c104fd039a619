"""Live: a pendulum that runs in real time while the estimates converge."""

from __future__ import annotations

from typing import Any

from dash import Input, Output, dcc, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env._typing import JSON
from pendulum_env.backends import BACKENDS
from pendulum_env.physics import BASE, effects
from pendulum_env.recording import Source, write_recording
from workbench.app import live, missing
from workbench.app.parts import EMPTY, aria, button, labelled, panel, spec
from workbench.app.recorder import free_name
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.app.torques import choices
from workbench.mistakes import InputError
from workbench.report.figure import Figure
from workbench.report.sections.schemes import convergence_figure, stroke
from workbench.report.words import estimate, name, number, opening, unit

RIG = "dm1015b"  # backend that is offered where a configuration was given on the command line
NAMES = {"replay": "a recording", RIG: "the rig", "mujoco": "MuJoCo"}  # of backends
BEAT = 250  # [ms] between two looks
SIGMAS = 2.0  # standard errors of an interval
PARAMETERS = tuple(column.name for term in BASE for column in term.columns)
FORM = ("live-backend", "live-excitation", "live-effect", "live-amplitude", "live-seconds")
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
    backends = [{"label": NAMES.get(id, id), "value": id} for id in BACKENDS if id != RIG or session.rig is not None]
    hidden = [{"label": "nothing", "value": ""}] + [{"label": opening(name(id)), "value": id} for id in effects()]
    replays = [{"label": one.recording.name, "value": one.file.name} for one in session.state.loaded]
    kept: dict[str, Any] = {"persistence": True, "persistence_type": "session"}
    fixed: dict[str, Any] = {"clearable": False, "searchable": False}
    peak = dcc.Input(None, type="number", id="live-amplitude", min=0, placeholder="usual", **kept)
    seconds = dcc.Input(30, type="number", id="live-seconds", min=2, max=live.LONGEST, **kept)
    replay = dcc.Dropdown(replays, replays[0]["value"] if replays else None, id="live-replay", **fixed)
    return [
        labelled("Backend", dcc.Dropdown(backends, "pymunk", id="live-backend", **fixed, **kept)),
        labelled("Excitation", dcc.Dropdown(choices(), "paper", id="live-excitation", **fixed, **kept)),
        labelled("Hidden effect", dcc.Dropdown(hidden, "", id="live-effect", clearable=False, **kept)),
        labelled("Peak torque [N m]", peak),
        labelled("Length [s]", seconds),
        html.Div(labelled("To replay", replay), id="live-replay-field", hidden=True),
    ]


def _views() -> list[Component]:
    """The pendulum, what is said of its model, and the estimates."""
    pendulum = panel(
        "Pendulum",
        html.Div(id="pendulum", role="img", **aria(label="The pendulum as it swings")),
        html.P("", id="live-said", className="note", role="status"),
    )
    plots = html.Div([_plot(plot, 210) for plot in PLOTS], className="grid")
    return [
        html.Div([pendulum, panel("What is missing", *missing.view(_plot))], className="columns live"),
        panel("Estimates", plots, html.Div(id="live-table"), className="estimates"),
    ]


def _plot(id: str, height: int) -> Component:
    """A plot whose figure comes with the beat."""
    options: dict[str, Any] = {"responsive": True, "config": {"displayModeBar": False}, "style": {"height": height}}
    drawn = dcc.Graph(id={"kind": "plot", "of": id}, figure=EMPTY, **options)
    place = html.Div(drawn, className="plot", style={"height": height})
    return html.Figure([dcc.Store(id={"kind": "plot-spec", "of": id}), place])


def figure(look: live.Look, column: int) -> Figure | None:
    """Estimates of one parameter over time, and at its right their intervals now."""
    found = look.identification
    if found is None:
        return None
    strokes = {id: stroke(k, id) for k, id in enumerate(found.schemes)}
    drawn = convergence_figure(found, column, strokes)
    layout = drawn.layout | {"xaxis": drawn.layout["xaxis"] | {"domain": [0, 0.74]}, "hovermode": False}
    layout |= {"xaxis2": {"domain": [0.8, 1], "anchor": "y", "range": [-0.7, len(strokes) - 0.3], "showgrid": False}}
    layout["xaxis2"] |= {"tickvals": [], "title": {"text": f"±{SIGMAS:g}σ now"}, "zeroline": False}
    for k, (id, one) in enumerate(found.schemes.items()):
        middle, std = float(one.convergence.theta[-1, column]), float(one.convergence.std[-1, column])
        drawn.data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": [k],
                "y": [middle],
                "xaxis": "x2",
                "error_y": {
                    "type": "constant",
                    "value": SIGMAS * std,
                    "color": strokes[id]["color"],
                    "thickness": 2,
                    "width": 3,
                },
                "marker": {
                    "color": strokes[id]["color"],
                    "size": 6,
                    "symbol": "circle-open" if "filtered" in id else "circle",
                },
            }
        )
    truth = look.truth.get(PARAMETERS[column])
    if truth is not None:
        layout["shapes"] = [
            {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": truth, "y1": truth, "layer": "below"}
            | {"line": {"color": "--muted", "width": 1.2, "dash": "dot"}}
        ]
    return Figure(PLOTS[column], drawn.label, drawn.data, layout, 210)


def _table(look: live.Look) -> Component | str:
    """Estimates of all schemes now, beside the truth where it is known."""
    found = look.identification
    if found is None:
        return ""
    model = next(iter(found.schemes.values())).model
    head = [html.Th("Scheme", scope="col")]
    head += [html.Th(f"{p} [{unit(model.estimates[p].unit)}]", scope="col", className="number") for p in PARAMETERS]
    rows = [
        html.Tr(
            [html.Th([_key(stroke(k, id)), opening(name(id))], scope="row")]
            + [html.Td(estimate(one.model.estimates[p]), className="number") for p in PARAMETERS]
        )
        for k, (id, one) in enumerate(found.schemes.items())
    ]
    if look.truth:
        known = [html.Td(number(look.truth[p], 4), className="number") for p in PARAMETERS]
        rows.append(html.Tr([html.Th("truth", scope="row"), *known], className="floor"))
    return html.Div(html.Table([html.Thead(html.Tr(head)), html.Tbody(rows)]), className="scroll", tabIndex=0)


def _key(line: JSON) -> Component:
    """A piece of a scheme's line."""
    kind = "dashed" if line["dash"] == "dash" else "solid"
    return html.I(className="stroke-key", style={"borderTop": f"2.5px {kind} var({line['color']})"})


def _said(look: live.Look) -> str:
    if look.trouble:
        return f"Stopped: {look.trouble.removesuffix('.')}."
    pace = "in real time" if look.pace > 0.97 else f"at {look.pace:.0%} of real time: this computer is busy"
    remark = f" · {look.remark}" if look.remark else ""
    return f"{look.time:.1f} s {pace}{remark}" if look.running else f"Ended after {look.time:.1f} s."


def connect(bench: Bench) -> None:
    """Wire start, stop, and the beat."""
    _connect_runs(bench)
    _connect_beat(bench)
    missing.connect(bench)


def _connect_runs(bench: Bench) -> None:
    """Wire what begins, ends and keeps a run."""

    @bench.on(Input("live-start", "n_clicks"), given=tuple(Value(c, "value") for c in (*FORM, "live-replay")))
    def start(session: Session, clicks: int, *chosen: Any) -> None:
        setup = _setup(session, clicks, *chosen)
        if session.run is not None:
            session.run.stop()
        try:
            session.run = live.Run(setup)
        except ValueError as error:
            raise InputError(str(error)) from None
        session.run.start()

    @bench.app.callback(
        Output("version", "data", allow_duplicate=True),
        Input("live-stop", "n_clicks"),
        Value("session", "data"),
        prevent_initial_call=True,
    )
    def stop(clicks: int, id: str) -> int:
        """Not by `bench.on`, which refuses while a job runs: a motor stops whenever it is told to."""
        if not clicks:
            raise PreventUpdate
        session = bench.sessions.of(id)
        session.halt()
        return session.version

    @bench.on(Input("live-keep", "n_clicks"))
    def keep(session: Session, _: int) -> None:
        if session.run is None:
            raise InputError("nothing has run yet: start a run first")
        session.run.stop()
        file = session.place(free_name(session))
        write_recording(session.run.recording(file.stem), file)
        session.keep(*session.take(file, Source(file)))

    @bench.app.callback(Output("live-replay-field", "hidden"), Input("live-backend", "value"))
    def has_none_to_replay(backend: str) -> bool:
        return backend != "replay"


def _setup(
    session: Session,
    seed: int,
    backend: str,
    excitation: str,
    effect: str,
    amplitude: float | None,
    seconds: float | None,
    replay: str | None,
) -> live.Setup:
    """What the controls say.

    Raises:
        InputError: if they make no sense.
    """
    if seconds is None or not 2 <= seconds <= live.LONGEST:
        raise InputError(f"a live run lasts from 2 to {live.LONGEST:g} s")
    if backend == "replay" and replay is None:
        raise InputError("there is no recording to replay: load one first")
    if backend == RIG and session.rig is None:
        raise InputError("there is no rig here: start the workbench with --config rig.toml")
    file = session.find(str(replay)).file if backend == "replay" else None
    rig = session.rig if backend == RIG else None
    hidden = (effect,) if effect and file is None and rig is None else ()
    return live.Setup(backend, excitation, amplitude, hidden, float(seconds), seed, file, rig)


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
        look = run.look()
        drawn = [*(figure(look, k) for k in range(len(PARAMETERS))), missing.course(look.following, look.time)]
        specs = [spec(one) if one is not None else None for one in drawn]
        motion = {"rows": look.motion.round(4).tolist(), "running": look.running}
        said = missing.told(look.following, look.running)
        return (*specs, motion, _said(look), _table(look), *said, not look.running)


HEADLINE = ("Live: a run of its own", "Estimates as they converge", "")
STAGE = Stage("live", "Live", show, connect, needs_model=False, headline=HEADLINE)
