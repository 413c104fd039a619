"""Data: recordings come in, are checked, and say what they can and cannot tell."""

from dataclasses import replace
from typing import Any

import numpy as np
from dash import dcc, html
from dash.development.base_component import Component

from estimators.figure import Figure, line, stacked
from pendulum_env.arms.body import Body
from pendulum_env.formatting import capitalise, format_number, format_percent, join_words
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording
from pendulum_env.thinning import thin
from pendulum_env.units import JointUnits
from workbench.app import card, recorder, uploads
from workbench.app.loaded import Loaded
from workbench.app.parts import UNWRAP, aria, button, drop, field, graph, panel, saves, table
from workbench.app.session import Action, Form, Session, Stage
from workbench.app.state import State
from workbench.app.uploads import MODEL, STUDY
from workbench.narrator.diagnosis import describe_disagreement
from workbench.narrator.effects import name
from workbench.narrator.findings import describe, describe_late
from workbench.narrator.notes import describe_note
from workbench.options import FORMATS
from workbench.robot import held_text

WHY = "No effect does that, and several may be found that only imitate it."
NUMBERS = ("Length [s]", "Rate [Hz]", "Samples", "In stick", "Turns", "Peak torque [N m]")
HEADERS = {"Recording": False} | dict.fromkeys(NUMBERS, True) | {"Use it to": False, "": False}  # are they numbers?


def show(session: Session) -> list[Component]:
    """Ways to get recordings, then what they are."""
    state = session.state
    parts: list[Component] = [card.show(one) for one in session.cards[:1]]
    beside = _record() if not isinstance(state.body, Body) else _robot(state, state.body)
    parts.append(html.Div([upload(state), beside], className="columns"))
    if state.loaded:
        plots = [graph(figure) for k, own in enumerate(state.recordings[:4]) for figure in _courses(state, k, own)]
        told = [*timing(state), _telling(state)] if state.body.can_simulate else []
        parts += [recordings(state), *told, html.Div(plots, className="panel")]
    return parts


def _robot(state: State, body: Body) -> Component:
    """The robot that the recordings are of."""
    texts = [
        f"{body.name}: {len(body.joints)} joints that move, {len(body.base)} base parameters",
        *(text for text in (held_text(body), *state.questions, state.trouble) if text),
        "columns are position_JOINT and torque_JOINT, or numbered; a study among the files says which joints move "
        "(joints) and what other columns mean",
    ]
    is_light = state.robot is not None and state.robot.weightless
    gravity = button(f"Its torques are with{'' if is_light else 'out'} gravity", "turn-gravity")
    leave = button("Leave the robot", "leave-robot")
    return panel("The robot", *(html.P(f"{capitalise(text)}.") for text in texts), leave, " ", gravity)


def _courses(state: State, k: int, recording: Recording) -> list[Figure]:
    """Position and torque of a recording over time, of an arm joint by joint."""
    height = {} if len(recording.joints) == 1 else {"height": 260}
    return [
        course(
            own,
            f"course-{k}-{n}",
            f"{joint}, {recording.name}" if joint else recording.name,
            state.body.units(joint, recording.units),
            **height,
        )
        for n, (joint, own) in enumerate(zip(recording.names, recording.joints, strict=True))
    ]


def upload(state: State) -> Component:
    """Render the upload of files."""
    ways = [
        drop([html.Strong("Choose recordings"), " or drop them here"], "upload", several=True),
        html.P(
            f"{FORMATS} with time, position and torque; 0 hangs down. What columns mean is "
            f"asked where their names do not tell, or told by a {STUDY} among the files. Of an arm, its URDF or MJCF "
            f"among the files tells the links. {STUDY} and {MODEL} of the stage Export, loaded together with the "
            "recordings, go on from there. "
            f"Up to {uploads.LARGEST / 1e6:.0f} MB at once; nothing leaves this computer.",
            className="note",
        ),
        dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], [], id=field("unwrap")),
    ]
    if not state.loaded:
        ways += [
            html.P(["No recording at hand? The demo has two of a pendulum that hides something."], className="or"),
            button("Try the demo", "demo", primary=True),
        ]
    return panel("Load recordings", *ways)


def _record() -> Component:
    return panel(
        "Or record a simulated pendulum",
        html.P(
            "The paper's pendulum at 1 kHz, behind its encoder, with "
            "0.02\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m of torque noise.",
            className="note",
        ),
        html.Div(recorder.fields(), className="fields"),
        button("Record", "record"),
    )


def recordings(state: State) -> Component:
    """Render the table of recordings; for an arm, turns and torque are the largest of its joints."""
    stick = _share_in_stick(state) if state.body.can_simulate else {}
    rows = [_row(one, recording, stick) for one, recording in zip(state.loaded, state.recordings, strict=True)]
    split = "Models are checked on the last 30 % of each recording, which no parameter is fitted to."
    note = [] if any(one.held_out for one in state.loaded) else [html.P(split, className="note")]
    how = html.Span("how these are read and used, for the command line and to load again with them", className="note")
    save = html.Div([saves(f"Save {STUDY}", "study"), how], className="row")
    return panel("Recordings", table(HEADERS, rows, "Recordings"), *note, save, className="recordings")


def _row(one: Loaded, recording: Recording, stick: dict[int, float]) -> tuple[Any, ...]:
    """Render a recording and its actions."""
    label = recording.name
    columns = button("Columns", "columns", one.id, className="link", **aria(label=f"Columns of {label}"))
    roles = [
        button(role, role, one.id, className="", **aria(pressed=is_so, label=f"{role} {label}"))
        for role, is_so in (("fit", str(not one.held_out).lower()), ("check", str(one.held_out).lower()))
    ]
    ways = [
        saves("Save", "recording", one.id, **aria(label=f"Save {label}")),
        button("Remove", "remove", one.id, **aria(label=f"Remove {label}")),
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
        format_percent(stick[id(recording)]) if id(recording) in stick else "–",
        format_number(float(np.ptp(recording.position, axis=0).max()) / (2 * np.pi), 2),
        format_number(float(np.abs(recording.torque).max()), 2),
        html.Div(roles, className="views", role="group"),
        html.Div(ways, className="row"),
    )


def _share_in_stick(state: State) -> dict[int, float]:
    """Share of each recording at rest, by its identity; where windows are cut from two parts of it, of the first."""
    if state.trouble:
        return {}
    training, testing = state.prepared.data.parts
    windows = [*testing.data.windows, *training.data.windows]
    return {id(w.recording): 1.0 - float(np.mean(w.moving)) for w in windows}


def _telling(state: State) -> Component:
    withheld = {parameter for doubt in state.doubts for parameter in doubt.withheld}
    terms = BASE if state.trouble else state.model.terms
    known = [name(column.name) for term in terms for column in term.columns if column.name not in withheld]
    can = [] if state.trouble or not known else [html.P(["They tell ", html.Strong(join_words(known)), "."])]
    texts = [state.trouble] if state.trouble else []
    texts += [*map(describe_disagreement, state.disagreements), *map(describe, state.doubts)]
    cannot = html.Ul([html.Li(capitalise(text)) for text in texts])
    nothing = html.P("Nothing in them stands in the way of the model's parameters.")
    return panel("What these recordings tell, and what not", *can, cannot if texts else nothing)


def timing(state: State) -> list[Component]:
    """Render the finding on timing as on the command line; empty without one."""
    if state.trouble:
        return []
    late, acts = (state.prepared.timed.find_timing(is_late) for is_late in (True, False))
    if late and state.is_aligned:
        said = [html.P(describe_late(own, "It is corrected in all that follows.")) for own in late]
        press = [button("Take it as it was logged", "align-back")]
    elif late:
        said = [html.P(describe_late(own, WHY)) for own in late]
        press = [button("Correct it", "align", primary=True)]
    else:
        said, press = [html.P(describe(own)) for own in acts], []
    return [panel("Torque and motion in time", *said, *press)] if said else []


def course(r: Recording, id: str, title: str, units: JointUnits, height: int = 340) -> Figure:
    """Position and torque over time."""
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


def _record_as_said(session: Session, _: str, form: Form) -> None:
    recorder.start(session, {recorder.free_name(session.state): recorder.options(form)})


def _align(session: Session, is_aligned: bool, what: str) -> None:
    session.change(what, session.state.anew(is_aligned=is_aligned))


def _turn_gravity(session: Session, *_: object) -> None:
    """Take the robot's torques for those without gravity, or again for those with it; the ladder starts anew."""
    if (robot := session.state.robot) is not None:
        robot = replace(robot, weightless=not robot.weightless)
        session.change("take gravity off, or back", session.state.anew(robot=robot))


ACTIONS: dict[str, Action] = {
    "upload": lambda session, _, came: session.receive(came["files"], came["unwrap"]),
    "demo": lambda session, *_: recorder.start_demo(session),
    "record": _record_as_said,
    "columns": lambda session, id, _: session.ask(id),
    "card-load": lambda session, _, form: session.answer(session.cards[0].filled(form)),
    "card-close": lambda session, *_: setattr(session, "cards", session.cards[1:]),
    "fit": lambda session, id, _: session.hold_out(id, False),
    "check": lambda session, id, _: session.hold_out(id, True),
    "remove": lambda session, id, _: session.remove(id),
    "align": lambda session, *_: _align(session, True, "correct the torque"),
    "align-back": lambda session, *_: _align(session, False, "take the torque as it was logged"),
    "leave-robot": lambda session, *_: session.change("leave the robot", State()),
    "turn-gravity": _turn_gravity,
}
STAGE = Stage("data", "Data", show, ACTIONS, lambda app, _: card.connect(app), needs_model=False)
