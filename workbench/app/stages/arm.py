"""The stages of an arm: what each shows where the recordings are of a robot. What their controls do is the stages'."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from functools import partial
from typing import Any

from dash import dcc, html
from dash.development.base_component import Component

from estimators.comparison import worst
from estimators.diagnosis.arm import gather_arm
from estimators.schemes.identification import SAVED
from estimators.show.story import TRUST, schemes_table
from pendulum_env.words import listing, name, number, opening
from workbench.app import card
from workbench.app.arm import WEIGHTLESS, ArmState
from workbench.app.parts import button, dropdown, fragment, graph, labelled, panel, table
from workbench.app.recorder import DIAGNOSIS
from workbench.app.saved import STUDY
from workbench.app.session import Session
from workbench.app.stages import add, data, diagnose, export, model
from workbench.app.state import NOTHING
from workbench.report.arm import ends, joints, parameters, strips
from workbench.report.sections.candidates import ranked
from workbench.robot import held_text


def arm_data(session: Session, state: ArmState) -> list[Component]:
    """The robot and its recordings, one strip of plots a joint."""
    parts: list[Component] = [card.show(one) for one in session.cards[:1]]
    parts.append(html.Div([data.upload(state), _robot(state)], className="columns"))
    if state.loaded:
        units = [partial(state.body.worded, joint) for joint in state.body.joints]
        recordings: list[Any] = state.recordings[: data.DRAWN]
        plots = [
            graph(data.course(own, f"course-{k}-{n}", f"{joint}, {one.name}", units[n], 260))
            for k, one in enumerate(recordings)
            for n, (joint, own) in enumerate(zip(state.body.joints, one.joints, strict=True))
        ]
        parts += [data.recordings(state), html.Div(plots, className="panel")]
    return parts


def _robot(state: ArmState) -> Component:
    body = state.body
    texts = [
        f"{body.name}: {len(body.joints)} joints that move, {len(body.base)} base parameters",
        *(text for text in (held_text(body), *state.questions, state.trouble) if text),
        "columns are position_JOINT and torque_JOINT, or numbered; a study among the files says which joints move "
        "(joints) and what other columns mean",
    ]
    gravity = button("Its torques are with gravity" if state.robot.weightless else WEIGHTLESS, "turn-gravity")
    leave = button("Leave the robot", "leave-robot")
    return panel("The robot", *(html.P(f"{opening(text)}.") for text in texts), leave, " ", gravity)


def arm_model(session: Session, state: ArmState) -> list[Component]:
    """What the model is, its parameters, and the schemes side by side."""
    del session
    about = "The torque of each joint is that of rigid links, M(q) q'' + C(q, q') q' + g(q), with friction and effects."
    found = schemes_table(state.fitted.identification)
    headers = {opening(name(text)): k > 0 and text not in found.left for k, text in enumerate(found.headers)}
    return [
        panel("The model", html.P(about)),
        panel("Parameters and how sure they are", fragment(parameters(ends(state.ladder)))),
        panel("Schemes side by side", table(headers, found.rows, "Schemes"), html.P(f"{opening(TRUST)}.")),
        model.begin_anew(state),
    ]


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
    section = strips(ends(state.ladder), gather_arm([recording], state.model.terms))  # type: ignore[list-item]
    parts = []
    for strip in section.content["strips"]:
        texts: list[Component] = []
        for own in strip["regions"]:
            texts.append(html.P(f"Under the {own['label']}{':' if own['regions'] else ' nothing stands out.'}"))
            texts.append(html.Ul([html.Li(opening(text)) for text in own["regions"]], className="regions-list"))
        plots = [graph(figure) for figure in strip["figures"]]
        parts.append(panel(strip["joint"], html.Div(plots, className="grid strip"), *texts))
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
    result = joints(ends(state.ladder), "held-out data", found.headline, found)
    return [
        panel(found.headline, fragment(result), className="story found" if found.selected else "story"),
        panel("Ranking", add.calls(state, busy), fragment(ranked(found.candidates)), className="ranking"),
        search,
    ]


def arm_add(session: Session, state: ArmState) -> list[Component]:
    """What could be added, and the errors of the ladder."""
    busy = session.busy()
    rungs = [("base model" if rung.added is None else f"+ {rung.added}", "", rung) for rung in state.ladder]
    undo = [button(f"Take {state.added[-1]} out", "undo", disabled=busy)] if state.added else []
    return [
        add.choice(state, busy, state.addable),
        panel("Errors step by step", fragment(joints(rungs, "held-out data", "")), *undo),
    ]


def arm_export(session: Session, state: ArmState) -> list[Component]:
    """What can be saved, and the same in two languages."""
    del session
    robot = html.P(f"{export.BESIDE} {state.robot.file.name} lies there, too.", className="note")
    return [
        export.downloads(state),
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
    robot, looked = state.robot, state.asked.effects
    terms = f"ArmModel.load({state.model_file!r}, body).terms" if state.model_file else "arm_base(body)"
    lines = [
        f"robot = RobotFile(Path({robot.file.name!r}), {robot.joints!r}, bolted={robot.bolted}, rotors={robot.rotors}, "
        f"weightless={robot.weightless})",
        f"body, fitted, held_out = robot.read_study({STUDY!r})",
        f"model = identify(fitted, {terms})[{SAVED!r}].model",
    ]
    for effect in export.moves(state):
        if effect:
            lines.append(f"model = add(model, {effect!r}, fitted, held_out).after.model")
        else:
            lines.append(f"found = diagnose(fitted, held_out, model.terms{state.asked.arguments(looked)})")
    return export.with_imports([*lines, f"model.save({export.MODEL!r})"])


def told(state: ArmState) -> tuple[str, str, list[Any]]:
    """Kicker, headline and lead of a state."""
    count = len(state.loaded)
    kicker = f"{state.robot.file.name} · {count} recording{'s' * (count != 1)}, {state.seconds:.3g} s"
    if state.trouble:
        return kicker, "Nothing can be fitted yet", [f"{opening(state.trouble)}."]
    kicker += f" · model: {state.model_file or 'base'}{''.join(f' + {effect}' for effect in state.added)}"
    first, last = (state.ladder[k].errors["holdout"] for k in (0, -1))
    left = listing(["–" if share is None else f"{number(100 * share, 2)} %" for share in last.shares.values()])
    lead = ["On data it was not fitted to, the model leaves ", html.B(left), " of the joints' torque."]
    if state.diagnosis is not None and (state.found or not state.added):
        return kicker, state.diagnosis.headline, lead
    if not state.added:
        return kicker, worst(last), lead
    falls = {at: first.joints[at] / last.joints[at] for at in last.joints}
    joint = max(falls, key=lambda at: falls[at])
    times = f"{number(falls[joint], 2)} times smaller"
    return kicker, f"With {listing(state.added)} the torque error of {joint} is {times}", lead


STAGES: dict[str, Callable[[Session, ArmState], list[Component]]] = {
    "data": arm_data,
    "model": arm_model,
    "compare": arm_compare,
    "diagnose": arm_diagnose,
    "add": arm_add,
    "export": arm_export,
}
