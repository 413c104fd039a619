"""Data: recordings come in, are checked, and say what they can and cannot tell."""

from typing import Any

import numpy as np
from dash import html
from dash.development.base_component import Component

from pendulum_env.arms.body import Body
from pendulum_env.formatting import capitalise, format_number, join_words
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording
from pendulum_env.thinning import thin
from pendulum_env.units import JointUnits
from workbench.app import card, demo
from workbench.app.parts import make_aria, make_button, make_graph, make_panel, make_save_button, make_table
from workbench.app.recordings import LoadedRecording
from workbench.app.session import Action, Session, Stage
from workbench.app.state import State
from workbench.app.uploads import STUDY
from workbench.figure import Figure, line, stacked
from workbench.narrator.diagnosis import describe_disagreement
from workbench.narrator.effects import name_effect
from workbench.narrator.findings import describe, describe_late
from workbench.narrator.notes import describe_note
from workbench.robot import describe_held

WHY = "No effect of the library does that, but several imitate it."
NUMBERS = ("Length [s]", "Rate [Hz]", "Samples", "Turns", "Peak torque [N m]")
HEADERS = {"Recording": False} | dict.fromkeys(NUMBERS, True) | {"Use it to": False, "": False}  # are they numbers?


def show(session: Session) -> list[Component]:
    """Show the ways to get recordings, then the recordings."""
    state = session.state
    parts: list[Component] = [card.show(one) for one in session.cards[:1]]
    if isinstance(state.body, Body):
        parts.append(_show_robot(state, state.body))
    elif not state.loaded:
        parts.append(_show_demo())
    if state.loaded:
        plots = [
            make_graph(figure) for k, own in enumerate(state.recordings[:4]) for figure in _plot_joints(state, k, own)
        ]
        told = [*show_timing(state), _show_findings(state)] if state.body.can_simulate else []
        parts += [show_recordings(state), *told, html.Div(plots, className="panel")]
    return parts


def _show_robot(state: State, body: Body) -> Component:
    """Show the robot that the recordings are of."""
    texts = [
        f"{body.name}: {len(body.joints)} joints that move, {len(body.base)} base parameters",
        *(text for text in (describe_held(body), *state.questions, state.trouble) if text),
        "columns are position_JOINT and torque_JOINT, or numbered; a study among the files says which joints move "
        "(joints) and what other columns mean",
    ]
    return make_panel("The robot", *(html.P(f"{capitalise(text)}.") for text in texts))


def _plot_joints(state: State, k: int, recording: Recording) -> list[Figure]:
    """Plot the position and torque of a recording over time, of an arm joint by joint."""
    height = {} if len(recording.joints) == 1 else {"height": 260}
    return [
        plot_recording(
            own,
            f"course-{k}-{n}",
            f"{joint}, {recording.name}" if joint else recording.name,
            state.body.units(joint, recording.units),
            **height,
        )
        for n, (joint, own) in enumerate(zip(recording.names, recording.joints, strict=True))
    ]


def _show_demo() -> Component:
    about = "The demo has two of a pendulum that hides something. "
    return make_panel("No recording at hand?", html.P([about, make_button("Try the demo", "demo")]))


def show_recordings(state: State) -> Component:
    """Render the table of recordings; for an arm, turns and torque are the largest of its joints."""
    rows = [_show_row(one, recording) for one, recording in zip(state.loaded, state.recordings, strict=True)]
    split = "Models are checked on the last 30 % of each recording, which no parameter is fitted to."
    note = [] if any(one.held_out for one in state.loaded) else [html.P(split, className="note")]
    how = html.Span("how these are read and used, for the command line and to load again with them", className="note")
    save = html.Div([make_save_button(f"Save {STUDY}", "study"), how], className="row")
    return make_panel("Recordings", make_table(HEADERS, rows, "Recordings"), *note, save, className="recordings")


def _show_row(one: LoadedRecording, recording: Recording) -> tuple[Any, ...]:
    """Render a recording and its actions."""
    label = recording.name
    columns = make_button("Columns", "columns", one.id, className="link", **make_aria(label=f"Columns of {label}"))
    roles = [
        make_button(role, role, one.id, className="", **make_aria(pressed=is_so, label=f"{role} {label}"))
        for role, is_so in (("fit", str(not one.held_out).lower()), ("check", str(one.held_out).lower()))
    ]
    return (
        [
            html.Strong(label),
            *(html.Div(capitalise(describe_note(note)), className="note") for note in recording.notes),
            columns,
        ],
        f"{recording.duration:.3g}",
        f"{recording.rate:.4g}",
        f"{len(recording):,}".replace(",", " "),
        format_number(float(np.ptp(recording.position, axis=0).max()) / (2 * np.pi), 2),
        format_number(float(np.abs(recording.torque).max()), 2),
        html.Div(roles, className="views", role="group"),
        make_button("Remove", "remove", one.id, **make_aria(label=f"Remove {label}")),
    )


def _show_findings(state: State) -> Component:
    withheld = {parameter for doubt in state.doubts for parameter in doubt.withheld}
    terms = BASE if state.trouble else state.model.terms
    known = [name_effect(column.name) for term in terms for column in term.columns if column.name not in withheld]
    can = [] if state.trouble or not known else [html.P(["They tell ", html.Strong(join_words(known)), "."])]
    texts = [state.trouble] if state.trouble else []
    texts += [*map(describe_disagreement, state.disagreements), *map(describe, state.doubts)]
    cannot = html.Ul([html.Li(capitalise(text)) for text in texts])
    nothing = html.P("They determine all parameters of the model.")
    return make_panel("What these recordings tell, and what not", *can, cannot if texts else nothing)


def show_timing(state: State) -> list[Component]:
    """Render the finding on timing as on the command line; empty without one."""
    if state.fit is None or not (state.fit.late or state.fit.slow):
        return []
    press = []
    if state.fit.late:
        said = "It is corrected in all that follows." if state.is_aligned else WHY
        texts = [describe_late(own, said) for own in state.fit.late]
        press = [] if state.is_aligned else [make_button("Correct it", "align", primary=True)]
    else:
        texts = [describe(own) for own in state.fit.slow]
    return [make_panel("Torque and motion in time", *map(html.P, texts), *press)]


def plot_recording(r: Recording, id: str, title: str, units: JointUnits, height: int = 340) -> Figure:
    """Plot the position and torque over time."""
    data, (angle, torque) = [], (units.unit("rad"), units.unit("N m"))
    for series, label, color, unit, where in (
        (r.position, "position", "--final", angle, "y"),
        (r.torque, "torque", "--train", torque, "y2"),
    ):
        kept = thin(series)
        data.append(line(r.time[kept], series[kept], label, color, unit, yaxis=where, showlegend=False))
    layout = stacked(f"position [{angle}]", f"{units.name('torque')} [{torque}]", "time [s]")
    layout["margin"] = {"t": 40}
    layout["title"] = {"text": title, "x": 0, "xref": "paper", "font": {"size": 14}}
    return Figure(id, f"Position and torque over time, {title}", data, layout, height)


def _align(session: Session, *_: object) -> None:
    session.change("correct the torque", session.state.restart(is_aligned=True))


ACTIONS: dict[str, Action] = {
    "demo": lambda session, *_: demo.start(session),
    "columns": lambda session, id, _: session.ask(id),
    "card-load": lambda session, _, form: session.answer(session.cards[0].fill_form(form)),
    "card-close": lambda session, *_: setattr(session, "cards", session.cards[1:]),
    "fit": lambda session, id, _: session.hold_out(id, False),
    "check": lambda session, id, _: session.hold_out(id, True),
    "remove": lambda session, id, _: session.remove(id),
    "align": _align,
}
STAGE = Stage("data", "Data", show, ACTIONS, needs_model=False)
