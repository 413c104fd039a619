"""Joints beside others of their kind."""

from __future__ import annotations

import numpy as np

from pendulum_env._typing import JSON
from workbench.report import words
from workbench.report.figure import Figure, axis, numbers
from workbench.report.fleet.courses import SIGMAS, _escaped
from workbench.report.section import Section
from workbench.survey.fleet import Fleet, Joint
from workbench.survey.tables import by_chance

PLOTTED = 4  # parameters
SHOWN = 120  # joints


def siblings(fleet: Fleet) -> Section | None:
    """Means of all joints by kind, and those that differ; nothing where no joint has a sibling."""
    kinds = [joint.kind for joint in fleet.joints]
    having = [joint for joint in fleet.joints if kinds.count(joint.kind) > 1]
    if not having:
        return None
    names = list(dict.fromkeys([one.series.parameter for one in fleet.odd] + fleet.parameters))[:PLOTTED]
    odd = {(one.joint.label, one.series.parameter) for one in fleet.odd}
    figures = [figure(having, name, odd, number) for number, name in enumerate(names)]
    rows = [(one, by_chance(one.odd.chance)) for one in fleet.odd]
    content = {"rows": rows, "figures": [one for one in figures if one.data], "sigmas": SIGMAS}
    return Section("siblings", "Siblings", "Joints beside their siblings", content)


def figure(joints: list[Joint], parameter: str, odd: set[tuple[str, str]], number: int) -> Figure:
    """Means of one parameter, a column for each kind."""
    data: list[JSON] = []
    having = [joint for joint in joints if parameter in joint.series]
    having.sort(key=lambda joint: ((joint.label, parameter) not in odd, joint.kind))
    shown = having[:SHOWN]
    for differs, color in ((False, "--train"), (True, "--base")):
        own = [joint for joint in shown if ((joint.label, parameter) in odd) is differs]
        if not own:
            continue
        means = [joint.series[parameter].drift for joint in own]
        data.append({
            "type": "scatter", "mode": "markers", "name": "differs" if differs else "like its siblings",
            "x": [_escaped(joint.kind or "–") for joint in own], "y": numbers(np.array([mean.level for mean in means])),
            "error_y": {"type": "data", "array": numbers(SIGMAS * np.array([mean.level_error for mean in means])),
                        "color": color, "thickness": 1.2, "width": 0},
            "marker": {"color": color, "size": 9 if differs else 6},
            "text": [_escaped(joint.label) for joint in own],
            "hovertemplate": "%{text}: %{y:.4g}<extra></extra>",
        })  # fmt: skip
    unit = having[0].series[parameter].unit if having else ""
    layout = {"xaxis": {"type": "category"}, "yaxis": axis(f"{parameter} [{words.unit(unit) or 1}]")}
    return Figure(f"siblings-{number}", f"Mean {parameter} of every joint, by kind", data, layout, 280)
