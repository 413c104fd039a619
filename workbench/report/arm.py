"""The report of an arm: errors joint by joint, where each joint's torque is not the model's, and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from estimators.arms.diagnosis import ArmDiagnosis, gather_arm
from estimators.arms.identification import ArmStep, JointError
from estimators.checks.residual import REGIONS, profiles, stand_out
from estimators.selection.data import PreparedData
from estimators.weak_form.dataset import NEGLIGIBLE
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.words import listing, percent
from workbench.report.figure import Section
from workbench.report.page import assemble
from workbench.report.sections.candidates import ranked
from workbench.report.sections.failures import key, profile_figure
from workbench.report.sections.parameters import of_models

SHOWN = ("position", "velocity", "time")  # a strip's plots
Drawn = tuple[str, str, ArmStep]  # how the page calls a model, the colour of its curves, and its errors


def render_arm(recordings: Sequence[ArmRecording], steps: Sequence[ArmStep], found: ArmDiagnosis | None = None) -> str:
    """The report as one self-contained HTML page.

    Args:
        recordings: what is drawn: those that were fitted, or that the model was compared with.
        steps: the base model and perhaps others, with their held-out errors.
        found: by a diagnosis; None for a comparison.
    """
    models = ends(steps, "model" if found is None else "base model")
    measured = "held-out data" if found is not None else "the recordings compared with"
    headline = found.headline if found is not None else worst(steps[-1].errors["holdout"])
    sections = [
        joints(models, measured, headline, found),
        strips(models, gather_arm(recordings, steps[-1].model.terms)),
        *([ranked(found.candidates)] if found is not None else []),
        parameters(models),
    ]
    what = "diagnosis of" if found is not None else "comparison with"
    return assemble(sections, f"{what} {listing([recording.name for recording in recordings])}")


def ends(steps: Sequence[ArmStep], first: str = "base model") -> list[Drawn]:
    """The first model and, where effects were added, the last one."""
    return [(first, "--base", steps[0]), ("final model", "--final", steps[-1])][: len(steps)]


def worst(errors: Sequence[JointError]) -> str:
    """The joint whose torque a model has least, in a headline."""
    most = max(errors, key=lambda error: error.share or 0.0)
    return f"The torque of {most.joint} is {percent(most.share or 0.0)} off, the most of {len(errors)} joints"


def joints(models: Sequence[Drawn], measured: str, headline: str, found: ArmDiagnosis | None = None) -> Section:
    """Torque errors of every joint under each model, on the data that `measured` names, and what a diagnosis found."""
    final = models[-1][2].model
    selected, left = (found.selected, found.unexplained.items()) if found is not None else ((), ())
    content = {
        "measured": measured,
        "labels": [label for label, _, _ in models],
        "rows": list(zip(*(step.errors["holdout"] for _, _, step in models), strict=True)),
        "laws": [(own.id, own.law, final.of(own.id)) for own in final.terms if own.id in selected],
        "unexplained": [(joint, size, final.body.worded(joint, NEWTON_METRE)) for joint, size in left],
        "next_step": found.next_step if found is not None else "",
    }
    return Section("joints", "Result", headline, content)


def strips(models: Sequence[Drawn], prepared: PreparedData) -> Section:
    """One strip of plots a joint: mean residual over angle, velocity and time, of each model."""
    curves, data = [(label, color) for label, color, _ in models], prepared.data
    last = models[-1][2].model
    residuals = [prepared.residual(step.model.terms, step.model.theta) for _, _, step in models]
    inertia = prepared.inertias(last.terms)
    found, standing = [], [False] * len(residuals)
    for k, joint in enumerate(data.joints):
        part, in_units = data.part(joint), partial(last.body.worded, joint)
        x, noise, lefts = part.samples, part.noise(inertia[joint]), [own[data.where(joint)] for own in residuals]
        negligible = NEGLIGIBLE * float(np.std(part.torque()))
        maps = [profiles(x, left, noise, SHOWN) for left in lefts]
        regions = [
            [
                replace(region, text=in_units(region.text))
                for region in stand_out(x, left, noise, SHOWN)
                if abs(region.residual) > negligible
            ]
            for left in lefts
        ]
        standing = [seen or bool(own) for seen, own in zip(standing, regions, strict=True)]
        reach = 1.08 * max(float(np.abs(item.mean).max()) for own in maps for item in own)
        still = regions[-1] if len(maps) > 1 else []
        figures = [
            profile_figure(curves, drawn, regions[0], still, reach, f"joint-{k}", in_units)
            for drawn in zip(*maps, strict=True)
        ]
        standing_out = [
            {"label": label, "regions": [region.text for region in own]}
            for (label, _), own in zip(curves, regions, strict=True)
        ]
        found.append({"joint": joint, "figures": figures, "regions": standing_out})
    entries = key(curves, standing[0], len(standing) > 1 and standing[-1])
    content = {"strips": found, "key": entries, "threshold": REGIONS.stands_out, "negligible": percent(NEGLIGIBLE)}
    return Section("strips", "Where it fails", "Where each joint's torque is not the model's", content)


def parameters(models: Sequence[Drawn]) -> Section:
    """Base parameters, and those of what acts at the joints, under each model."""
    combined = [parameter for parameter in models[-1][2].model.body.base if len(parameter.parts) > 1]
    return of_models([step.model for _, _, step in models], [label for label, _, _ in models], combined)
