"""Export: the report, the model, and how to do the same without a browser."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from typing import Any

from dash import Input, Output, dcc, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from workbench.app.parts import button, panel
from workbench.app.recorder import DIAGNOSIS
from workbench.app.session import STUDY, Session
from workbench.app.stage import Bench, Stage
from workbench.app.state import State, ids
from workbench.report import render

PROGRAM, MODEL, REPORT, EXPERIMENT = "pendulum-ident", "model.json", "report.html", "experiment.csv"
WHOLE = (
    "This fits the whole of each recording. The workbench and Python hold the last 30 % back to check on, so that "
    "their estimates differ a little."
)
BESIDE = f"The recordings are read as {STUDY} says: save it beside them, in the stage Data."
UNREPORTED = f"Once there is a diagnosis, a line here writes {REPORT}, too."


def show(session: Session) -> list[Component]:
    """What can be saved, and the same in two languages."""
    state = session.state
    diagnosed = state.diagnosis is not None
    saved = [
        _saved("report", REPORT, "one file to share: story, plots and tables; it needs no network and prints", True),
        _saved("model", MODEL, "terms and parameters of the ladder's last model, for the command line and Python"),
    ]
    if diagnosed:
        saved.append(
            _saved(
                "diagnosis",
                DIAGNOSIS,
                "verdicts and reasons, for programs; the command record plays the experiment it suggests",
            )
        )
    if state.diagnosis is not None and state.diagnosis.suggestion is not None:
        saved.append(_saved("experiment", EXPERIMENT, "torque of the next experiment over time, for your controller"))
    unreported = [] if diagnosed else [html.P(UNREPORTED, className="note")]
    return [
        panel("Save", html.Ul(saved, className="downloads")),
        panel(
            "The same on the command line",
            *([html.P(BESIDE, className="note")] if _needs_study(state) else []),
            *([html.P(WHOLE, className="note")] if _fits_more(state) else []),
            *unreported,
            _code(session.plain(commands(state)), "commands"),
        ),
        panel("The same in Python", *unreported, _code(snippet(state), "snippet")),
    ]


def _saved(id: str, file: str, what: str, primary: bool = False) -> Component:
    return html.Li([button(file, {"save": id}, primary=primary), html.Span(what)])


def _code(text: str, id: str) -> Component:
    copy = dcc.Clipboard(target_id=id, title="copy", className="copy")
    return html.Div([html.Pre(text, id=id, tabIndex=0), copy], className="code")


def commands(state: State) -> str:
    """Command lines that come to the same model."""
    lines = [shlex.join([PROGRAM, "record", *one.origin, "-o", one.file.name]) for one in state.loaded if one.origin]
    train = [one.file.name for one in state.loaded if not one.held_out]
    holdout = [word for one in state.loaded if one.held_out for word in ("--holdout", one.file.name)]
    if _needs_study(state):
        train, holdout = [STUDY], []  # which says what is held out
    limits = state.asked.options("fix", "bound")
    align = [*["--align"] * state.is_aligned, *limits]
    before, start = _diagnosed_after(state), state.model_file
    models = [start or MODEL, *[MODEL] * len(state.added)]  # before each effect, and after the last
    adding = [
        shlex.join([PROGRAM, "add", model, effect, *train, *holdout, *align, "-o", MODEL])
        for model, effect in zip(models, state.added, strict=False)
    ]
    if start:
        lines.append(shlex.join([PROGRAM, "compare", start, *train, *["--align"] * state.is_aligned]))
    else:
        lines.append(shlex.join([PROGRAM, "identify", *train, *align, "-o", MODEL]))
    lines += adding[:before]
    if state.diagnosis is not None:
        base = ["--model", models[before]] if before or start else []
        outputs = ["--report", REPORT, "--json", DIAGNOSIS]
        looked = [*state.asked.options("only", "without"), *limits]
        lines.append(shlex.join([PROGRAM, "diagnose", *train, *holdout, *base, *looked, *outputs]))
    return "\n".join([*lines, *adding[before:]])


def _diagnosed_after(state: State) -> int:
    """Number of effects that were in the model when it was diagnosed."""
    return len([effect for effect in state.added if effect in ids(state.started)])


def _needs_study(state: State) -> bool:
    """Whether a study has to say how the recordings are read."""
    return not all(one.is_plain for one in state.loaded)


def _fits_more(state: State) -> bool:
    """Whether `identify` makes the model, and fits what the workbench holds out: `add` would hold it out as well."""
    return not (state.added or state.holdout or state.model_file)


def snippet(state: State) -> str:
    """Python that comes to the same model."""
    train = [one.file.name for one in state.loaded if not one.held_out]
    holdout = [one.file.name for one in state.loaded if one.held_out]
    before = _diagnosed_after(state)
    asked, limits = state.asked, state.asked.arguments(state.asked.limits)
    adding = [f"model = add(model, {effect!r}, recordings, holdout{limits}).after.model" for effect in state.added]
    start = "Model" if state.model_file else "BASE" if limits else ""
    diagnosed = state.diagnosis is not None
    used = [*["Aligned"] * state.is_aligned, *["add"] * bool(adding), *["diagnose"] * diagnosed, "fit", "gather"]
    lines = [
        f"from estimators import {', '.join(used)}",
        *(["from estimators.arguments import within_limits"] if limits else []),
        *([f"from pendulum_env.physics import {start}"] if start else []),
        f"from pendulum_env.recording import {'read_study' if _needs_study(state) else 'read_recording'}",
        *(["from workbench.report import write_report"] if diagnosed else []),
        "",
        *(
            [f"study = read_study({STUDY!r})", "recordings, holdout = study.fitted, study.held_out"]
            if _needs_study(state)
            else [
                f"recordings = [read_recording(path) for path in {train!r}]",
                f"holdout = [read_recording(path) for path in {holdout!r}]",
            ]
        ),
        *(
            ["aligned = Aligned.of(recordings, holdout)", "recordings, holdout = aligned.recordings, aligned.holdout"]
            if state.is_aligned
            else []
        ),
        *([f"terms = {f'Model.load({state.model_file!r}).terms' if state.model_file else 'BASE'}"] if start else []),
        *([f"terms, _ = within_limits(terms, {{}}{limits})"] if limits else []),
        f"model = fit(*gather(recordings, holdout){', terms' if start else ''}).model",
        *adding[:before],
    ]
    if diagnosed:
        lines.append(f"found = diagnose(recordings, holdout, model.terms{asked.arguments(asked.effects)}{limits})")
        lines.append(f"write_report({REPORT!r}, recordings, holdout, found)")
    return "\n".join([*lines, *adding[before:], f"model.save({MODEL!r})"])


def _report(state: State) -> str:
    return render(state.train, state.holdout, state.told, state.identification)


def _model(state: State) -> str:
    return json.dumps(state.model.json(), indent=1) + "\n"


def _diagnosis(state: State) -> str:
    return json.dumps(state.told.json(), indent=1) + "\n"


def _experiment(state: State) -> str:
    assert state.diagnosis is not None and state.diagnosis.suggestion is not None  # else there is no button
    return state.diagnosis.suggestion.csv()


FILES: dict[str, tuple[str, Callable[[State], str]]] = {
    "report": (REPORT, _report),
    "model": (MODEL, _model),
    "diagnosis": (DIAGNOSIS, _diagnosis),
    "experiment": (EXPERIMENT, _experiment),
}


def connect(bench: Bench) -> None:
    """Wire the files."""
    for id, (file, write) in FILES.items():
        _connect(bench, id, file, write)


def _connect(bench: Bench, id: str, file: str, write: Callable[[State], str]) -> None:
    @bench.app.callback(
        Output("download", "data", allow_duplicate=True),
        Input({"save": id}, "n_clicks"),
        Value("session", "data"),
        prevent_initial_call=True,
    )
    def save(clicks: int, session: str) -> dict[str, Any]:
        if not clicks:
            raise PreventUpdate
        return {"filename": file, "content": write(bench.sessions.of(session).state)}


STAGE = Stage("export", "Export", show, connect)
