"""The stages of an arm: what each shows where the recordings are of a robot. What their controls do is the stages'."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from dash import dcc, html
from dash.development.base_component import Component

from estimators.arms.diagnosis import gather_arm
from pendulum_env.words import listing, name, number, opening
from workbench.app import card
from workbench.app.arm import WEIGHTLESS, ArmState
from workbench.app.asked import NOTHING
from workbench.app.parts import button, dropdown, fragment, graph, labelled, panel, saves, table
from workbench.app.recorder import DIAGNOSIS
from workbench.app.saved import STUDY
from workbench.app.session import Session
from workbench.app.stages import add, data, diagnose, export, model
from workbench.arms import SAVED, TRUST, schemes_table
from workbench.report.arm import Drawn, joints, parameters, strips, worst
from workbench.report.figure import Figure
from workbench.report.sections.candidates import ranked
from workbench.robot import held_text


def arm_data(session: Session, state: ArmState) -> list[Component]:
    """The robot and its recordings, one strip of plots a joint."""
    parts: list[Component] = [card.show(one) for one in session.cards[:1]]
    parts.append(html.Div([data.upload(state), _robot(state)], className="columns"))
    if state.loaded:
        plots = [graph(figure) for k in range(min(len(state.loaded), data.DRAWN)) for figure in _courses(state, k)]
        parts += [data.recordings(state), html.Div(plots, className="panel")]
    return parts


def _robot(state: ArmState) -> Component:
    body = state.body
    said = [
        f"{body.name}: {len(body.joints)} joints that move, {len(body.base)} base parameters.",
        *([f"{opening(text)}."] if (text := held_text(body)) else []),
        *(f"{opening(text)}." for text in state.questions),
        *([f"{opening(state.trouble)}."] if state.trouble else []),
        "Columns are position_JOINT and torque_JOINT, or numbered; a study among the files says which joints move "
        "(joints) and what other columns mean.",
    ]
    gravity = button("Its torques are with gravity" if state.robot.weightless else WEIGHTLESS, "turn-gravity")
    return panel("The robot", *(html.P(text) for text in said), button("Leave the robot", "leave-robot"), " ", gravity)


def _courses(state: ArmState, k: int) -> list[Figure]:
    """Position and torque of each joint over time."""
    recording: Any = state.recordings[k]
    joints = zip(state.body.joints, recording.joints, strict=True)
    return [
        data.course(own, f"course-{k}-{n}", f"{joint}, {recording.name}", partial(state.body.said, joint), 260)
        for n, (joint, own) in enumerate(joints)
    ]


def arm_model(session: Session, state: ArmState) -> list[Component]:
    """What the model is, its parameters, and the schemes side by side."""
    del session
    about = "The torque of each joint is that of rigid links, M(q) q'' + C(q, q') q' + g(q), with friction and effects."
    found = schemes_table(state.fitted.identification)
    headers = {opening(name(text)): k > 0 and text not in found.left for k, text in enumerate(found.headers)}
    return [
        panel("The model", html.P(about)),
        panel("Parameters and how sure they are", fragment(parameters(drawn(state)))),
        panel("Schemes side by side", table(headers, found.rows, "Schemes"), html.P(f"{opening(TRUST)}.")),
        model.begin_anew(state),
    ]


def drawn(state: ArmState, part: str = "holdout") -> list[Drawn]:
    """The ends of the ladder, with their errors on one part of the data."""
    return [Drawn(label, color, rung.model, getattr(rung, part)) for label, color, rung in state.models]


def arm_compare(session: Session, state: ArmState) -> list[Component]:
    """Which recording, then errors and one strip of plots a joint."""
    del session
    names = [{"label": one.recording.name, "value": one.id} for one in state.loaded]
    return [
        html.Div(
            [
                labelled("Recording", dropdown("shown", names, names[0]["value"], searchable=False)),
                html.Div(dcc.RadioItems([0], 0, id="of"), hidden=True),
            ],
            className="fields wide",
        ),
        html.P("", id="selected", hidden=True),
        dcc.Store(id="lit"),
        html.Div(views(state, names[0]["value"]), id="views"),
    ]


def views(state: ArmState, id: str) -> list[Component]:
    """Residuals of a recording, joint by joint, under the ends of the ladder."""
    recording = state.recordings[state.loaded.index(state.find(id))]
    section = strips(drawn(state), gather_arm([recording], state.last.model.terms))  # type: ignore[list-item]
    parts = []
    for strip in section.content["strips"]:
        told: list[Component] = []
        for own in strip["regions"]:
            told.append(html.P(f"Under the {own['label']}{':' if own['regions'] else ' nothing stands out.'}"))
            told.append(html.Ul([html.Li(opening(text)) for text in own["regions"]], className="regions-list"))
        plots = [graph(figure) for figure in strip["figures"]]
        parts.append(panel(strip["joint"], html.Div(plots, className="grid strip"), *told))
    return parts


def arm_diagnose(session: Session, state: ArmState) -> list[Component]:
    """The search, then its result."""
    busy, found = session.busy(), state.diagnosis
    about = (
        "Every effect of the library is tried at every joint that it can be at. It counts as missing only if it lowers "
        "errors on data that it was not fitted to."
    )
    search = panel(
        "Search for what is missing",
        html.P(about),
        diagnose.choices(state, bool(session.notice) or state.asked != NOTHING, state.library),
        button("Diagnose" if found is None else "Diagnose again", "diagnose", primary=found is None, disabled=busy),
    )
    if found is None:
        return [search]
    result = joints(drawn(state), "held-out data", found.headline, found)
    return [
        panel(found.headline, fragment(result), className="story found" if found.selected else "story"),
        panel("Ranking", add.calls(state, busy), fragment(ranked(found.candidates)), className="ranking"),
        search,
    ]


def arm_add(session: Session, state: ArmState) -> list[Component]:
    """What could be added, and the errors of the ladder."""
    busy = session.busy()
    labels = ["base model", *(f"+ {effect}" for effect in state.added)]
    rungs = [Drawn(label, "", rung.model, rung.holdout) for label, rung in zip(labels, state.rungs, strict=True)]
    undo = [button(f"Take {state.added[-1]} out", "undo", disabled=busy)] if state.added else []
    return [
        add.choice(state, busy, state.addable),
        panel("Errors step by step", fragment(joints(rungs, "held-out data", "")), *undo),
    ]


def arm_export(session: Session, state: ArmState) -> list[Component]:
    """What can be saved, and the same in two languages."""
    del session
    saved = [
        (export.REPORT, "report", "one file to share: story, plots and tables; it needs no network and prints"),
        (export.MODEL, "model", "terms and parameters of the ladder's last model, for the command line and Python"),
    ]
    saved += [(DIAGNOSIS, "diagnosis", "verdicts, for programs")] if state.diagnosis is not None else []
    rows = [html.Li([saves(file, id, primary=id == "report"), html.Span(what)]) for file, id, what in saved]
    robot = html.P(f"{export.BESIDE} {state.robot.file.name} lies there, too.", className="note")
    return [
        panel("Save", html.Ul(rows, className="downloads")),
        panel("The same on the command line", robot, export.code(commands(state), "commands")),
        panel("The same in Python", robot, export.code(snippet(state), "snippet")),
    ]


def commands(state: ArmState) -> str:
    """Command lines that come to the same model."""
    robot = ["--robot", state.robot.file.name, "--base", "fixed"]
    robot += ["--rotors"] * bool(state.robot.rotors) + ["--no-gravity"] * state.robot.weightless
    start = state.model_file or export.MODEL
    lines = [] if state.model_file else [["identify", STUDY, *robot, "--scheme", SAVED, "-o", start]]
    for effect in export.moves(state):
        if effect:
            lines.append(["add", start, effect, STUDY, *robot, "-o", export.MODEL])
            start = export.MODEL
        else:
            looked = state.asked.options("only", "without")
            written = ["--report", export.REPORT, "--json", DIAGNOSIS]
            lines.append(["diagnose", STUDY, *robot, "--model", start, *looked, *written])
    return "\n".join(shlex.join([export.PROGRAM, *words]) for words in lines)


def snippet(state: ArmState) -> str:
    """Python that comes to the same model."""
    body, moves, looked = state.body, export.moves(state), state.asked.effects
    held = f", held={dict(body.held)!r}" if body.held else ""
    rotors = f", rotors={state.robot.rotors}" if state.robot.rotors is not None else ""
    weightless = ".weightless" * state.robot.weightless
    given: list[Any] = [one.recording for one in state.loaded]
    has_loads, is_chosen = any(one.currents or one.carried for one in given), state.asked != NOTHING
    terms = f"ArmModel.load({state.model_file!r}, body).terms[1:]" if state.model_file else "None"
    used = {"add_arm": any(moves), "diagnose_arm": "" in moves, "identify_arm": True}
    arms = ["ArmModel"] * bool(state.model_file) + ["read_arm_source", "read_body"]
    lines = [
        f"from estimators.arms import {', '.join(name for name, is_used in used.items() if is_used)}",
        *["from estimators.arms.gains import in_torque, without_loads"] * has_loads,
        f"from pendulum_env.arms import {', '.join(arms)}",
        "from pendulum_env.recording.study import read_sources",
        *["from workbench.robot import looked_for"] * ("" in moves and is_chosen),
        "",
        f"sources = read_sources({STUDY!r})",
        f"body = read_body({state.robot.file.name!r}, joints=sources[0].joints{held}, bolted=True{rotors}){weightless}",
        "others = {*body.held, *body.links} - {*body.joints}",
        "recordings = [read_arm_source(one, body.joints, others) for one in sources]",
        *["recordings = in_torque(recordings, body).recordings"] * has_loads,
        "fitted, held_out = (",
        "    [own for one, own in zip(sources, recordings) if one.role == role]",
        '    for role in ("fit", "holdout")',
        ")",
        *["fitted, held_out = without_loads(fitted, held_out)"] * has_loads,
        f"model = identify_arm(fitted, body, {terms})[{SAVED!r}].model",
    ]
    for effect in moves:
        if effect:
            lines.append(f"model = add_arm(model, {effect!r}, fitted, held_out).after.model")
        else:
            library = ", library=library" * is_chosen
            if is_chosen:
                lines.append(f"library = looked_for(body, {looked['only']!r}, {looked['without']!r})")
            lines.append(f"found = diagnose_arm(fitted, body, held_out, terms=model.terms[1:]{library})")
    return "\n".join([*lines, f"model.save({export.MODEL!r})"])


def told(state: ArmState) -> tuple[str, str, list[Any]]:
    """Kicker, headline and lead of a state."""
    count = len(state.loaded)
    kicker = f"{state.robot.file.name} · {count} recording{'s' * (count != 1)}, {state.seconds:.3g} s"
    if state.trouble:
        return kicker, "Nothing can be fitted yet", [f"{opening(state.trouble)}."]
    kicker += f" · model: {state.model_file or 'base'}{''.join(f' + {effect}' for effect in state.added)}"
    errors = state.last.holdout
    lead = ["On data it was not fitted to, the model leaves ", html.B(shares(errors)), " of the joints' torque."]
    if state.diagnosis is not None and (state.found or not state.added):
        return kicker, state.diagnosis.headline, lead
    if not state.added:
        return kicker, worst(errors), lead
    falls = [first.torque_rms / last.torque_rms for first, last in zip(state.rungs[0].holdout, errors, strict=True)]
    joint, times = errors[int(np.argmax(falls))].joint, f"{number(max(falls), 2)} times smaller"
    return kicker, f"With {listing(state.added)} the torque error of {joint} is {times}", lead


def shares(errors: Sequence[Any]) -> str:
    """What is left of each joint's torque."""
    return listing(["–" if one.share is None else f"{number(100 * one.share, 2)} %" for one in errors])


STAGES: dict[str, Callable[[Session, ArmState], list[Component]]] = {
    "data": arm_data,
    "model": arm_model,
    "compare": arm_compare,
    "diagnose": arm_diagnose,
    "add": arm_add,
    "export": arm_export,
}
