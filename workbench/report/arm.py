"""The report of an arm: errors joint by joint, where each joint's torque is not the model's, and parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from estimators.arms.diagnosis import ArmDiagnosis, gather_arm, parted
from estimators.arms.identification import JointError
from estimators.checks.residual import STANDS_OUT, profiles, stand_out
from estimators.selection.data import Evidence, inertias
from estimators.weak_form.dataset import NEGLIGIBLE
from pendulum_env.arms.model import ArmModel
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.files import write_whole
from pendulum_env.recording.record import NEWTON_METRE
from pendulum_env.words import listing, percent
from workbench.report.figure import Section
from workbench.report.page import assemble
from workbench.report.sections.candidates import ranked
from workbench.report.sections.failures import key, profile_figure
from workbench.report.sections.parameters import of_models

SHOWN = ("position", "velocity", "time")  # a strip's plots


@dataclass(frozen=True, eq=False)
class Drawn:
    """One model of the report: how the page calls it, the style of its curves, and its errors joint by joint."""

    label: str
    color: str
    model: ArmModel
    errors: tuple[JointError, ...]


def write_arm_report(
    path: str | Path, recordings: Sequence[ArmRecording], holdout: Sequence[ArmRecording], diagnosis: ArmDiagnosis
) -> None:
    """Write a diagnosis of an arm as one self-contained HTML file, like that of a pendulum.

    Args:
        path: of the file, written whole or not at all.
        recordings: what the diagnosis was made from.
        holdout: what was held out; empty if the end of each recording was.
        diagnosis: what was found.

    Raises:
        OSError: if the file cannot be written.
    """
    write_whole(path, render_arm(recordings, holdout, diagnosis))


def render_arm(recordings: Sequence[ArmRecording], holdout: Sequence[ArmRecording], diagnosis: ArmDiagnosis) -> str:
    """HTML of the report; see `write_arm_report`."""
    models = of_diagnosis(diagnosis)
    evidence = gather_arm(parted(recordings, holdout)[0], diagnosis.model.terms)
    result = joints(models, "held-out data", diagnosis.headline, diagnosis)
    subject = f"diagnosis of {listing([recording.name for recording in recordings])}"
    return assemble([result, strips(models, evidence), ranked(diagnosis.candidates), parameters(models)], subject)


def of_diagnosis(diagnosis: ArmDiagnosis) -> list[Drawn]:
    """The base model and, where effects were found, the final one."""
    models = [Drawn("base model", "--base", diagnosis.base, diagnosis.before)]
    if diagnosis.selected:
        models.append(Drawn("final model", "--final", diagnosis.model, diagnosis.after))
    return models


def render_arm_comparison(recordings: Sequence[ArmRecording], model: ArmModel, errors: tuple[JointError, ...]) -> str:
    """HTML of a comparison; see `write_arm_comparison_report`."""
    models = [Drawn("model", "--base", model, errors)]
    result = joints(models, "the recordings compared with", worst(errors))
    shown = [result, strips(models, gather_arm(recordings, model.terms)), parameters(models)]
    return assemble(shown, f"comparison with {listing([recording.name for recording in recordings])}")


def worst(errors: Sequence[JointError]) -> str:
    """The joint whose torque a model has least, in a headline."""
    most = max(errors, key=lambda error: error.share or 0.0)
    return f"The torque of {most.joint} is {percent(most.share or 0.0)} off, the most of {len(errors)} joints"


def write_arm_comparison_report(
    path: str | Path, recordings: Sequence[ArmRecording], model: ArmModel, errors: tuple[JointError, ...]
) -> None:
    """Write how far a model's torque is from recordings, and where, as one self-contained HTML file.

    Args:
        path: of the file, written whole or not at all.
        recordings: what it was compared with.
        model: of the arm.
        errors: that `compare_arm` found.

    Raises:
        OSError: if the file cannot be written.
    """
    write_whole(path, render_arm_comparison(recordings, model, errors))


def joints(models: Sequence[Drawn], measured: str, headline: str, found: ArmDiagnosis | None = None) -> Section:
    """Torque errors of every joint under each model, measured on what is said, and what a diagnosis found."""
    final = models[-1].model
    laws = [
        (own.id, own.law, final.of(own.id)) for own in final.terms if found is not None and own.id in found.selected
    ]
    left = found.unexplained.items() if found is not None else ()
    content = {
        "measured": measured,
        "labels": [drawn.label for drawn in models],
        "rows": list(zip(*(drawn.errors for drawn in models), strict=True)),
        "laws": laws,
        "unexplained": [(joint, size, final.body.said(joint, NEWTON_METRE)) for joint, size in left],
        "next_step": found.next_step if found is not None else "",
    }
    return Section("joints", "Result", headline, content)


def strips(models: Sequence[Drawn], evidence: Evidence) -> Section:
    """One strip of plots a joint: mean residual over angle, velocity and time, of each model."""
    curves = [(drawn.label, drawn.color) for drawn in models]
    data, body = evidence.data, models[-1].model.body
    residuals = [evidence.residual(drawn.model.terms, drawn.model.theta) for drawn in models]
    inertia = inertias(evidence.screen, models[-1].model.terms)
    found, standing = [], [False] * len(residuals)
    for k, joint in enumerate(data.joints):
        part, here = data.part(joint), data.where(joint)
        x, noise = part.samples, part.noise(inertia[joint])
        negligible = NEGLIGIBLE * float(np.std(part.torque()))
        maps = [profiles(x, own[here], noise, SHOWN) for own in residuals]
        regions = [
            [
                replace(region, text=body.said(joint, region.text))
                for region in stand_out(x, own[here], noise, SHOWN)
                if abs(region.residual) > negligible
            ]
            for own in residuals
        ]
        standing = [seen or bool(own) for seen, own in zip(standing, regions, strict=True)]
        reach = 1.08 * max(float(np.abs(item.mean).max()) for own in maps for item in own)
        still = regions[-1] if len(maps) > 1 else []
        said = partial(body.said, joint)
        figures = [
            profile_figure(curves, [own[place] for own in maps], regions[0], still, reach, f"joint-{k}", said)
            for place in range(len(SHOWN))
        ]
        told = [
            {"label": drawn.label, "regions": [region.text for region in own]}
            for drawn, own in zip(models, regions, strict=True)
        ]
        found.append({"joint": joint, "figures": figures, "regions": told})
    entries = key(curves, standing[0], len(standing) > 1 and standing[-1])
    content = {"strips": found, "key": entries, "threshold": STANDS_OUT, "negligible": percent(NEGLIGIBLE)}
    return Section("strips", "Where it fails", "Where each joint's torque is not the model's", content)


def parameters(models: Sequence[Drawn]) -> Section:
    """Base parameters, and those of what acts at the joints, under each model."""
    combined = [parameter for parameter in models[-1].model.body.base if len(parameter.parts) > 1]
    return of_models([drawn.model for drawn in models], [drawn.label for drawn in models], combined)
