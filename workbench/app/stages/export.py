"""Download the report, the model and other files, and show the equivalent command lines."""

from base64 import b64encode
from typing import Any

import dash
from dash import ALL, Dash, Input, Output, dcc, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from workbench.app.downloads import DIAGNOSIS, EXPERIMENT, REPORT, is_study_needed, make_file, write_commands
from workbench.app.parts import Stage, make_panel, make_save_button
from workbench.app.session import Session, Sessions
from workbench.app.state import State
from workbench.app.uploads import MODEL, STUDY

FIT_NOTE = (
    "This fits the whole of each recording. The workbench holds the last 30 % back to check on, so that "
    "their estimates differ a little."
)
STUDY_NOTE = f"The recordings are read as {STUDY} says: save it beside them."


def show(session: Session) -> list[Component]:
    """Render the downloads and the command lines."""
    state = session.state
    fits_more = not (state.added or state.data.holdout or state.model_file)  # `add` would also hold out the last 30 %
    notes = [STUDY_NOTE] * is_study_needed(state) + [FIT_NOTE] * fits_more
    notes += [f"{state.robot.file.name} lies there, too."] if state.robot is not None else []
    paragraphs = [html.P(text, className="note") for text in notes]
    copy = dcc.Clipboard(target_id="commands", title="copy", className="copy")
    code = html.Div([html.Pre(write_commands(state), id="commands", tabIndex=0), copy], className="code")
    return [
        show_downloads(state),
        make_panel("The same on the command line", *paragraphs, code),
    ]


def show_downloads(state: State) -> Component:
    """Render a save button with a description for each file."""
    saved = {
        "report": (REPORT, "one file to share: story, plots and tables; it needs no network and prints"),
        "model": (MODEL, "terms and parameters of the last model, for the command line and Python"),
        "study": (STUDY, f"how the recordings are read and used: load them with it and {MODEL} to go on another day"),
    }
    if state.diagnosis is not None:
        saved["diagnosis"] = DIAGNOSIS, "verdicts and reasons, for programs"
    if state.diagnosis is not None and state.diagnosis.suggestion is not None and state.diagnosis.suggestion.signal:
        saved["experiment"] = EXPERIMENT, "torque of the next experiment over time, for your controller or for record"
    buttons = {id: make_save_button(file, id, primary=id == "report") for id, (file, _) in saved.items()}
    rows = [html.Li([buttons[id], html.Span(text)]) for id, (_, text) in saved.items()]
    return make_panel("Save", html.Ul(rows, className="downloads"))


def connect(app: Dash, sessions: Sessions) -> None:
    """Register the callback that sends a file."""

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
