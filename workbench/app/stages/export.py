"""Export: the report, the model, and how to do the same without a browser."""

import json
import shlex
import tempfile
from base64 import b64encode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import dash
from dash import ALL, Dash, Input, Output, dcc, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from estimators.schemes.result import SAVED
from pendulum_env.lookup import find
from pendulum_env.recording.study import collect_log_format, write_study
from workbench.app.parts import make_panel, make_save_button
from workbench.app.session import Session, Sessions, Stage
from workbench.app.state import State, list_added
from workbench.app.uploads import MODEL, STUDY
from workbench.errors import InputError
from workbench.narrator.diagnosis import write_diagnosis
from workbench.report import render

PROGRAM = "pendulum-ident"
REPORT, DIAGNOSIS, EXPERIMENT = "report.html", "diagnosis.json", "experiment.csv"
WHOLE = (
    "This fits the whole of each recording. The workbench holds the last 30 % back to check on, so that "
    "their estimates differ a little."
)
BESIDE = f"The recordings are read as {STUDY} says: save it beside them."


def show(session: Session) -> list[Component]:
    """Render the downloads, and the equivalent commands."""
    state = session.state
    fits_more = not (state.added or state.holdout or state.model_file)  # `add` would hold the last 30 % out as well
    notes = [BESIDE] * _is_study_needed(state) + [WHOLE] * fits_more
    notes += [f"{state.robot.file.name} lies there, too."] if state.robot is not None else []
    beside = [html.P(text, className="note") for text in notes]
    return [
        show_downloads(state),
        make_panel("The same on the command line", *beside, show_code(write_commands(state), "commands")),
    ]


def show_downloads(state: State) -> Component:
    """Render the downloads."""
    saved = {
        "report": (REPORT, "one file to share: story, plots and tables; it needs no network and prints"),
        "model": (MODEL, "terms and parameters of the ladder's last model, for the command line and Python"),
        "study": (STUDY, f"how the recordings are read and used: load them with it and {MODEL} to go on another day"),
    }
    if state.diagnosis is not None:
        saved["diagnosis"] = DIAGNOSIS, "verdicts and reasons, for programs"
    if state.diagnosis is not None and state.diagnosis.suggestion is not None and state.diagnosis.suggestion.signal:
        saved["experiment"] = EXPERIMENT, "torque of the next experiment over time, for your controller or for record"
    rows = [
        html.Li([make_save_button(file, id, primary=id == "report"), html.Span(what)])
        for id, (file, what) in saved.items()
    ]
    return make_panel("Save", html.Ul(rows, className="downloads"))


def show_code(text: str, id: str) -> Component:
    """Show the lines to copy."""
    copy = dcc.Clipboard(target_id=id, title="copy", className="copy")
    return html.Div([html.Pre(text, id=id, tabIndex=0), copy], className="code")


def write_commands(state: State) -> str:
    """Write the command lines that come to the same model."""
    train, holdout = _list_files(state)
    given = [*train, *(word for file in holdout for word in ("--holdout", file))]
    if _is_study_needed(state):
        train = given = [STUDY]  # which says what is held out
    limits, align = state.asked.write_options("fix", "bound"), ["--align"] * state.is_aligned
    lines = [["record", *one.origin, "-o", one.source.file.name] for one in state.loaded if one.origin]
    model, scheme = state.model_file, list[str]()
    if (robot := state.robot) is not None:
        of_robot = ["--robot", robot.file.name, *["--rotors"] * bool(robot.rotors)]
        train = given = [*given, *of_robot, *["--no-gravity"] * robot.weightless]
        scheme = ["--scheme", SAVED]
    if model:
        lines.append(["compare", model, *train, *align])
    else:
        lines.append(["identify", *train, *scheme, *align, *limits, "-o", MODEL])
    for effect in list_moves(state):
        if effect:
            lines.append(["add", model or MODEL, effect, *given, *align, *limits, "-o", MODEL])
            model = MODEL
        else:
            looked = [*(["--model", model] if model else []), *state.asked.write_options("only", "without"), *limits]
            lines.append(["diagnose", *given, *looked, "--report", REPORT, "--json", DIAGNOSIS])
    return "\n".join(shlex.join([PROGRAM, *words]) for words in lines)


def _list_files(state: State) -> tuple[list[str], list[str]]:
    """List the names of files with fitted and held-out recordings."""
    train, holdout = ([s.source.file.name for s in state.loaded if s.held_out == held] for held in (False, True))
    return train, holdout


def list_moves(state: State) -> list[str]:
    """List the steps from the base model: added effects, and an empty text for a diagnosis."""
    before = len([effect for effect in state.added if effect in list_added(state.started)])
    return [*state.added[:before], *[""] * (state.diagnosis is not None), *state.added[before:]]


def _is_study_needed(state: State) -> bool:
    """Return whether a study file is needed for columns or joints."""
    sources = [one.source for one in state.loaded]
    return state.robot is not None or any(own.columns or own.unwrap or own.range or own.load for own in sources)


def write_study_text(state: State) -> str:
    """Write a study that names the recordings as they are read, for a folder that holds them."""
    with tempfile.TemporaryDirectory() as folder:
        file, joints = Path(folder) / STUDY, state.robot.joints if state.robot is not None else None
        sources = [replace(one.source, joints=joints) for one in state.loaded]
        write_study([replace(source, file=file.with_name(source.file.name)) for source in sources], file)
        return file.read_text(encoding="utf-8")


def _format_json(content: Any) -> str:
    return json.dumps(content, indent=1) + "\n"


def _write_model(state: State) -> str:
    fitted = [one.recording for one in state.loaded if not one.held_out]
    return _format_json(replace(state.model, log_format=collect_log_format(fitted)).json())


def _write_experiment(state: State) -> str:
    if state.diagnosis is None or state.diagnosis.suggestion is None or state.diagnosis.suggestion.signal is None:
        raise InputError("the diagnosis suggests no experiment")
    return state.diagnosis.suggestion.csv()


FILES: dict[str, tuple[str, Callable[[State], str]]] = {  # name and content of what any stage saves
    "report": (REPORT, lambda state: render(state.result, write_commands(state))),
    "model": (MODEL, _write_model),
    "diagnosis": (DIAGNOSIS, lambda state: _format_json(write_diagnosis(state.result))),
    "experiment": (EXPERIMENT, _write_experiment),
    "study": (STUDY, write_study_text),
}


def make_file(state: State, what: str) -> tuple[str, bytes]:
    """Name and content of one of `FILES`."""
    name, content = find("file", what, FILES)
    return name, content(state).encode()


def connect(app: Dash, sessions: Sessions) -> None:
    """Wire the files."""

    @app.callback(
        Output("download", "data"),
        Input({"save": ALL}, "n_clicks"),
        Value("session", "data"),
        prevent_initial_call=True,
    )
    def save(_: list[int], id: str) -> dict[str, Any]:
        if not any(entry["value"] for entry in dash.ctx.triggered):
            raise PreventUpdate
        name, content = make_file(sessions.find_session(id).state, dash.ctx.triggered_id["save"])
        return {"filename": name, "content": b64encode(content).decode(), "base64": True}


STAGE = Stage("export", "Export", show, connect=connect)
