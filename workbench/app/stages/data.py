"""Data: recordings come in, are checked, and say what they can and cannot tell."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import dash
import numpy as np
from dash import ALL, Input, Output, State, dcc, html
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env.physics import BASE, effects
from workbench.app import card, recorder, timing
from workbench.app.parts import aria, button, graph, labelled, panel, table
from workbench.app.session import STUDY, Session
from workbench.app.stage import Bench, Stage
from workbench.app.state import Loaded
from workbench.app.state import State as Work
from workbench.app.torques import choices
from workbench.app.uploads import UNWRAP, UPLOAD
from workbench.inputs import FORMATS
from workbench.report.figure import Figure, line, stacked, thin
from workbench.report.sections.method import Used, use
from workbench.report.words import listing, name, number, opening, percent

DRAWN = 4  # recordings that are drawn
FORM = ("excitation", "seconds", "effect", "amplitude", "seed")  # controls of a recording, in the order of `options`


def show(session: Session) -> list[Component]:
    """Ways to get recordings, then what they are."""
    state = session.state
    parts: list[Component] = [card.show(one, session) for one in session.cards[:1]]
    parts.append(html.Div([_upload(state), _record()], className="columns"))
    if state.loaded:
        parts.append(_recordings(state))
        parts += timing.show(state)
        parts.append(_telling(state))
        parts.append(
            html.Div([graph(_course(one, k)) for k, one in enumerate(state.loaded[:DRAWN])], className="panel")
        )
    return parts


def _upload(state: Work) -> Component:
    ways = [
        dcc.Upload(
            [html.Strong("Choose recordings"), " or drop them here"],
            id="upload",
            multiple=True,
            max_size=UPLOAD,
            className="drop",
            className_active="drop over",
            style={},
        ),
        html.P(
            f"{FORMATS} with time, position and torque; 0 hangs down. What columns mean is "
            f"asked where their names do not tell, or told by a {STUDY} among the files. "
            f"Up to {UPLOAD / 1e6:.0f} MB each; nothing leaves this computer.",
            className="note",
        ),
        dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], [], id="unwrap"),
        dcc.Upload(
            html.Button("Open a saved session", type="button", className="action"),
            id="open-session",
            max_size=UPLOAD,
            className="open",
            style={},
        ),
    ]
    if not state.loaded:
        ways += [
            html.P(["No recording at hand? The demo has two of a pendulum that hides something."], className="or"),
            button("Try the demo", "demo", primary=True),
        ]
    most: dict[str, Any] = {"data-most": str(UPLOAD)}  # so that the page can say why it refuses a file
    return panel("Load recordings", html.Div(ways, **most))


def _record() -> Component:
    hidden = [{"label": "nothing", "value": ""}]
    hidden += [{"label": opening(name(id)), "value": id} for id in effects()]
    kept: dict[str, Any] = {"persistence": True, "persistence_type": "session"}
    fields = [
        labelled(
            "Excitation", dcc.Dropdown(choices(), "paper", id="excitation", clearable=False, searchable=False, **kept)
        ),
        labelled("Hidden effect", dcc.Dropdown(hidden, "", id="effect", clearable=False, **kept)),
        labelled("Length [s]", dcc.Input(20, type="number", id="seconds", min=1, max=recorder.LONGEST, **kept)),
        labelled(
            "Peak torque [N m]", dcc.Input(None, type="number", id="amplitude", min=0, placeholder="usual", **kept)
        ),
        labelled("Seed", dcc.Input(0, type="number", id="seed", min=0, step=1, **kept)),
    ]
    return panel(
        "Or record a simulated pendulum",
        html.P(
            "The paper's pendulum at 1 kHz, behind its encoder, with "
            "0.02\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m of torque noise.",
            className="note",
        ),
        html.Div(fields, className="fields"),
        button("Record", "record"),
    )


def _recordings(state: Work) -> Component:
    used = _used(state)
    rows = []
    for one in state.loaded:
        recording, facts, file = one.recording, used.get(id(one.recording)), one.file.name
        rows.append(
            (
                [
                    html.Strong(recording.name),
                    *(html.Div(opening(note), className="note") for note in recording.notes),
                    _columns(one),
                ],
                f"{recording.duration:.3g}",
                f"{recording.rate:.4g}",
                f"{len(recording):,}".replace(",", " "),
                percent(facts.at_rest) if facts else "–",
                f"{number(float(np.ptp(recording.position)) / (2 * np.pi), 2)}",
                number(float(np.abs(recording.torque).max()), 2),
                html.Div([_role(one, "fit", False), _role(one, "check", True)], className="views", role="group"),
                html.Div(
                    [
                        button("Save", {"do": "save", "of": file}, **aria(label=f"Save {recording.name}")),
                        button("Remove", {"do": "remove", "of": file}, **aria(label=f"Remove {recording.name}")),
                    ],
                    className="row",
                ),
            )
        )
    headers = (
        ("Recording", False),
        ("Length [s]", True),
        ("Rate [Hz]", True),
        ("Samples", True),
        ("In stick", True),
        ("Turns", True),
        ("Peak torque [N m]", True),
        ("Use it to", False),
        ("", False),
    )
    split = (
        ""
        if state.holdout
        else "Models are checked on the last 30 % of each recording, which no parameter is fitted to."
    )
    save = html.Div(
        [
            button(f"Save {STUDY}", "save-study"),
            html.Span(
                "how these are read and used, for the command line and to load again with them", className="note"
            ),
        ],
        className="row",
    )
    note = [html.P(split, className="note")] if split else []
    return panel("Recordings", table(headers, rows, "Recordings"), *note, save, className="recordings")


def _columns(one: Loaded) -> Component:
    """Button that asks what the columns mean."""
    id, label = {"do": "columns", "of": one.file.name}, f"Columns of {one.recording.name}"
    return html.Button("Columns", id=id, n_clicks=0, type="button", className="link", **aria(label=label))


def _role(one: Loaded, label: str, held_out: bool) -> Component:
    """Button that has a recording fitted, or held out."""
    chosen = one.held_out == held_out
    what = aria(pressed=str(chosen).lower(), label=f"{label} {one.recording.name}")
    return html.Button(label, id={"do": label, "of": one.file.name}, n_clicks=0, type="button", **what)


def _used(state: Work) -> dict[int, Used]:
    """How each recording is used, by its identity; where windows are cut from two parts of it, of the first."""
    if not state.ladder:
        return {}
    case = state.standing
    windows = [
        *((w, "checked") for w in case.testing.data.windows),
        *((w, "fitted") for w in case.training.data.windows),
    ]
    return {id(w.recording): use(w, part) for w, part in windows}


def _telling(state: Work) -> Component:
    terms = state.model.terms if state.ladder else BASE
    doubts = state.doubts if state.train else ()
    withheld = {parameter for doubt in doubts for parameter in doubt.withheld}
    known = [name(column.name) for term in terms for column in term.columns if column.name not in withheld]
    can = [html.P(["They tell ", html.Strong(listing(known)), "."])] if known and state.ladder else []
    texts = [*(one.text for one in state.disagreements), *(doubt.text for doubt in doubts)]
    cannot = [html.Li(f"{opening(text)}.") for text in texts]
    if state.trouble:
        cannot.insert(0, html.Li(f"{opening(state.trouble)}."))
    rest = [html.Ul(cannot)] if cannot else [html.P("Nothing in them stands in the way of the model's parameters.")]
    return panel("What these recordings tell, and what not", *can, *rest)


def _course(one: Loaded, k: int) -> Figure:
    """Position and torque over time."""
    r = one.recording
    data = []
    for series, label, color, unit, where in (
        (r.position, "position", "--final", "rad", "y"),
        (r.torque, "torque", "--train", "N m", "y2"),
    ):
        kept = thin(series)
        data.append(line(r.time[kept], series[kept], label, color, unit, yaxis=where, showlegend=False))
    layout = stacked("position [rad]", "torque [N m]", "time [s]")
    layout["margin"] = {"t": 40}
    layout["title"] = {"text": r.name, "x": 0, "xref": "paper", "font": {"size": 14}}
    return Figure(f"course-{k}", f"Position and torque over time, {r.name}", data, layout, 340)


def connect(bench: Bench) -> None:
    """Wire uploads, columns, recording, roles and removal."""
    card.connect(bench)
    timing.connect(bench)

    @bench.on(
        Input("upload", "contents"),
        given=(State("upload", "filename"), State("unwrap", "value"), State("chosen", "data")),
    )
    def upload(session: Session, contents: list[str], names: list[str], unwrap: list[str], chosen: list[str]) -> None:
        came = zip(names, contents, strict=True)
        order = {name: place for place, name in enumerate(chosen or [])}
        session.receive(sorted(came, key=lambda one: order.get(one[0], len(order))), bool(unwrap))

    @bench.on(Input("open-session", "contents"), given=(State("open-session", "filename"),))
    def open_session(session: Session, content: str, name: str) -> None:
        session.open(name, content)

    @bench.on(Input("demo", "n_clicks"))
    def demo(session: Session, _: int) -> None:
        recorder.start(session, bench.workers, recorder.DEMO)

    @bench.on(Input("record", "n_clicks"), given=tuple(State(control, "value") for control in FORM))
    def record(
        session: Session, _: int, excitation: str, seconds: float, effect: str, amplitude: float, seed: float
    ) -> None:
        options = recorder.options(excitation, seconds, effect, amplitude, seed)
        recorder.start(session, bench.workers, [(recorder.free_name(session), options, False)])

    @bench.on(Input({"do": "remove", "of": ALL}, "n_clicks"))
    def remove(session: Session, _: list[int]) -> None:
        session.remove(dash.ctx.triggered_id["of"])

    @bench.on(Input({"do": "fit", "of": ALL}, "n_clicks"), Input({"do": "check", "of": ALL}, "n_clicks"))
    def role(session: Session, *_: list[int]) -> None:
        session.hold_out(dash.ctx.triggered_id["of"], dash.ctx.triggered_id["do"] == "check")

    @bench.app.callback(
        Output("download", "data", allow_duplicate=True),
        Input({"do": "save", "of": ALL}, "n_clicks"),
        State("session", "data"),
        prevent_initial_call=True,
    )
    def save(clicks: list[int], id: str) -> dict[str, Any]:
        if not any(clicks):
            raise PreventUpdate
        file = bench.sessions.of(id).find(dash.ctx.triggered_id["of"]).file
        return {"filename": file.name, "content": b64encode(file.read_bytes()).decode(), "base64": True}

    @bench.app.callback(
        Output("download", "data", allow_duplicate=True),
        Input("save-study", "n_clicks"),
        State("session", "data"),
        prevent_initial_call=True,
    )
    def save_study(clicks: int, id: str) -> dict[str, Any]:
        if not clicks:
            raise PreventUpdate
        return {"filename": STUDY, "content": bench.sessions.of(id).study()}


STAGE = Stage("data", "Data", show, connect, needs_model=False)
