"""Load recordings, plot them, and show which parameters they determine."""

import re
from typing import Any

import numpy as np
from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise, format_number
from pendulum_env.recording import Recording
from pendulum_env.robot_file import RobotFile
from workbench.app import card_form, demo
from workbench.app.panels import show_findings, show_timing
from workbench.app.parts import (
    Action,
    Stage,
    make_aria,
    make_button,
    make_late,
    make_panel,
    make_save_button,
    make_table,
    show_content,
)
from workbench.app.session import Session
from workbench.app.state import LoadedRecording, State
from workbench.app.uploads import STUDY, guess_role
from workbench.narrator.notes import describe_note
from workbench.report.recordings import DRAWN, measure_recording, plot_recording
from workbench.robot import describe_held, describe_held_joint_motion

HEADERS = {  # with the class of each column
    "Recording": "",
    "Length [s]": "number small",
    "Rate [Hz]": "number medium",
    "Samples": "number wide",
    "Turns": "number medium",
    "Peak torque [N m]": "number wide",
    "Use it to": "",
    "": "",
}

NAMED = "Recordings named holdout, test or valid check the models. The switch decides."


def show(session: Session) -> list[Component]:
    """Render column forms, the demo, and the loaded recordings with plots."""
    state = session.state
    parts: list[Component] = [card_form.show(card) for card in session.cards[:1]]
    if state.robot is not None:
        parts.append(_show_robot(state, state.robot))
    elif not state.loaded:
        demo_button = make_button("Try the demo", "demo")
        about = "The demo has two of a pendulum that hides something. "
        parts.append(make_panel("No recording at hand?", html.P([about, demo_button])))
    if state.loaded:
        plots = [
            figure
            for k, recording in enumerate(state.recordings[:DRAWN])
            for figure in plot_recording(recording, k, state.body)
        ]
        findings = [make_late("timing"), show_findings(state)] if state.body.can_simulate else []
        parts += [show_recordings(state), *findings, html.Div(show_content(plots, "courses"), className="panel")]
    return parts


def _show_robot(state: State, robot: RobotFile) -> Component:
    """Render the robot, its held joints and its errors."""
    recordings = [item.recording for item in state.loaded]
    body = robot.hold_joints(recordings)
    moving_joints = describe_held_joint_motion(robot, body, recordings)
    texts = [
        f"{body.name}: {len(body.joints)} joints that move, {len(body.base)} base parameters",
        *filter(None, (describe_held(body), *moving_joints, state.failure_reason)),
        "columns are position_JOINT and torque_JOINT, or numbered; a study among the files says which joints move "
        "(joints) and what other columns mean",
    ]
    return make_panel("The robot", *(html.P(f"{capitalise(text)}.") for text in texts))


def show_recordings(state: State) -> Component:
    """Render the table of recordings; for an arm, turns and torque are the largest among the joints."""
    rows = [_show_row(item, recording) for item, recording in zip(state.loaded, state.recordings, strict=True)]
    split = "Models are checked on the last 30 % of each recording, which no parameter is fitted to."
    named = any(item.held_out and guess_role(item.source.file.name) == "holdout" for item in state.loaded)
    notes = [NAMED] * named or [split] * (not any(item.held_out for item in state.loaded))
    note = [html.P(text, className="note") for text in notes]
    text = html.Span("how these are read and used, for the command line and to load again with them", className="note")
    save = html.Div([make_save_button(f"Save {STUDY}", "study"), text], className="row")
    return make_panel("Recordings", make_table(HEADERS, rows, "Recordings"), *note, save, className="recordings")


def _show_row(loaded: LoadedRecording, recording: Recording) -> tuple[Any, ...]:
    """Render a recording's row with its buttons."""
    label = recording.name
    columns = make_button("Columns", "columns", loaded.id, className="link", **make_aria(label=f"Columns of {label}"))
    roles = [
        make_button(role, role, loaded.id, className="", **make_aria(pressed=is_so, label=f"{role} {label}"))
        for role, is_so in (("fit", str(not loaded.held_out).lower()), ("check", str(loaded.held_out).lower()))
    ]
    return (
        [
            html.Strong([part for word in re.split(r"(?<=[._-])", label) for part in (word, html.Wbr())]),
            *(html.Div(capitalise(describe_note(note)), className="note") for note in recording.notes),
            columns,
        ],
        *measure_recording(recording),
        format_number(float(np.abs(recording.torque).max()), 2) if np.any(recording.torque) else "none",
        html.Div(roles, className="views", role="group"),
        make_button("Remove", "remove", loaded.id, **make_aria(label=f"Remove {label}")),
    )


ACTIONS: dict[str, Action] = {
    "demo": lambda session, *_: demo.start(session),
    "columns": lambda session, id, _: session.open_card(id),
    "card-load": lambda session, _, form: session.apply_card(session.cards[0].fill_form(form)),
    "card-close": lambda session, *_: setattr(session, "cards", session.cards[1:]),
    "fit": lambda session, id, _: session.hold_out(id, False),
    "check": lambda session, id, _: session.hold_out(id, True),
    "remove": lambda session, id, _: session.remove(id),
    "align": lambda session, *_: session.change("correct the torque", session.state.restart(is_aligned=True)),
}
STAGE = Stage("data", "Data", show, ACTIONS, {"timing": show_timing}, needs_model=False)
