"""Sections of an arm's report: errors, one strip of residuals a joint, parameters."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from estimators.checks.residual import STANDS_OUT, Region, profiles, stand_out
from estimators.selection.data import inertias
from estimators.weak_form.dataset import TRIFLE
from pendulum_env._typing import JSON
from pendulum_env.recording.record import NEWTON_METRE
from workbench.report.arm.case import ArmCase
from workbench.report.section import Section
from workbench.report.sections.failures import key, profile_figure
from workbench.report.words import percent

SHOWN = ("position", "velocity", "time")  # a strip's plots


def joints(case: ArmCase, headline: str) -> Section:
    """Torque errors of every joint under each model."""
    rows = list(zip(*(drawn.errors for drawn in case.models), strict=True))
    final = case.final.model
    laws = [(own.id, own.law, final.of(own.id)) for own in final.terms if own.id in case.selected]
    content = {
        "measured": case.measured,
        "labels": [drawn.label for drawn in case.models],
        "rows": rows,
        "laws": laws,
        "unexplained": [
            (joint, size, case.final.model.body.said(joint, NEWTON_METRE)) for joint, size in case.unexplained.items()
        ],
        "next_step": case.next_step,
    }
    return Section("joints", "Result", headline, content)


def strips(case: ArmCase) -> Section:
    """One strip of plots a joint: mean residual over angle, velocity and time, of each model."""
    curves = [(drawn.label, drawn.color) for drawn in case.models]
    data, models = case.evidence.data, [drawn.model.terms for drawn in case.models]
    residuals = [
        case.evidence.residual(terms, drawn.model.theta) for terms, drawn in zip(models, case.models, strict=True)
    ]
    inertia = inertias(case.evidence.screen, models[-1])
    found, standing = [], [False] * len(residuals)
    for k, joint in enumerate(case.joints):
        part, here = data.part(joint), data.where(joint)
        x, noise = part.samples, part.noise(inertia[joint])
        trifle = TRIFLE * float(np.std(part.torque()))
        maps = [profiles(x, own[here], noise, SHOWN) for own in residuals]
        regions = [[r for r in stand_out(x, own[here], noise, SHOWN) if abs(r.residual) > trifle] for own in residuals]
        body = case.final.model.body
        regions = [[replace(r, text=body.said(joint, r.text)) for r in own] for own in regions]
        standing = [seen or bool(own) for seen, own in zip(standing, regions, strict=True)]
        reach = 1.08 * max(float(np.abs(item.mean).max()) for own in maps for item in own)
        still = regions[-1] if len(maps) > 1 else []
        figures = [
            profile_figure(
                curves,
                [own[place] for own in maps],
                regions[0],
                still,
                reach,
                f"joint-{k}",
                partial(body.said, joint),
            )
            for place in range(len(SHOWN))
        ]
        found.append({"joint": joint, "figures": figures, "regions": _told(case, regions)})
    entries = key(curves, standing[0], len(standing) > 1 and standing[-1])
    content = {"strips": found, "key": entries, "threshold": STANDS_OUT, "trifle": percent(TRIFLE)}
    return Section("strips", "Where it fails", "Where each joint's torque is not the model's", content)


def _told(case: ArmCase, regions: list[list[Region]]) -> list[JSON]:
    pairs = zip(case.models, regions, strict=True)
    return [{"label": drawn.label, "regions": [region.text for region in own]} for drawn, own in pairs]


def parameters(case: ArmCase) -> Section:
    """Base parameters and friction under each model."""
    model = case.final.model
    rows = [
        (name, estimate.unit, [drawn.model.estimates.get(name) for drawn in case.models])
        for name, estimate in model.estimates.items()
    ]
    combined = [parameter for parameter in model.body.base if len(parameter.parts) > 1]
    content = {"labels": [d.label for d in case.models], "rows": rows, "combined": combined}
    return Section("base", "Parameters", "Parameters", content)
