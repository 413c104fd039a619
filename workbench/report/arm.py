"""The report of an arm: errors joint by joint, where each joint's torque is not the model's, and parameters."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from estimators.data.regions import find_regions_at
from estimators.data.regression_data import RegressionData
from estimators.signals.residual import REGIONS, compute_profiles
from estimators.weak_form.torque_windows import NEGLIGIBLE
from pendulum_env.formatting import format_percent
from pendulum_env.physics import Model, Term
from workbench.narrator.diagnosis import describe_next_step, describe_result, describe_unexplained
from workbench.narrator.parts import Content, Part
from workbench.narrator.results import CLEAR
from workbench.narrator.tables import JOINT_LEGEND, tabulate_joints
from workbench.report.data import DrawnModel, ReportData, Section, list_ends
from workbench.report.failures import list_key, list_regions, plot_profile
from workbench.report.numbers import make_parameters
from workbench.report.story import rank_candidates

SHOWN = ("position", "velocity", "time")  # a strip's plots


def make_sections(case: ReportData) -> list[Section]:
    """Build the sections of a report on an arm, for a diagnosis or a comparison."""
    found = case.diagnosis
    return [
        make_result(case),
        make_strips(list_ends(found.steps, case.first), case.data.parts[0]),
        *([rank_candidates(found.candidates)] if found.candidates else []),
        make_parameters(case),
    ]


def make_result(case: ReportData) -> Section:
    """Make the section on added effects, torque errors of joints, and the next step."""
    found, models = case.diagnosis, list_ends(case.diagnosis.steps, case.first)
    selected = tuple(_describe_law(found.model, own) for own in found.model.terms if own.id in found.selected)
    left = tuple(describe_unexplained(found, region) for region in found.unexplained)
    errors = [step.errors["holdout"] for _, _, step in models]
    content: list[Any] = [
        *([Part("Added effects", [selected])] if selected else []),
        f"Torque errors (RMS) on {'held-out data' if found.searched else 'all data'}, {CLEAR}",
        tabulate_joints(errors, found.floors, found.model, [label for label, _, _ in models]),
        JOINT_LEGEND,
    ]
    if found.searched:
        content += [describe_next_step(found), *([Part("Left unexplained", [left])] if left else [])]
    return Section("joints", "Result", describe_result(found), content)


def _describe_law(model: Model, term: Term) -> str:
    """Describe an added effect by its law and its parameters."""
    values = ", ".join(f"{name} {own.shown}" for name, own in model.get_parameters(term.id).items())
    return f"{term.id}: {term.law}; {values}"


def make_strips(models: Sequence[DrawnModel], prepared: RegressionData) -> Section:
    """Plot the mean residual over angle, velocity and time for each joint and model."""
    curves, data = [(label, color) for label, color, _ in models], prepared.data
    residuals = [prepared.residual(step.model.terms, step.model.theta) for _, _, step in models]
    found, standing = [], [False] * len(residuals)
    for k, joint in enumerate(data.joints):
        x, noise, units = data.part(joint).samples, prepared.floors[joint], prepared.units(joint)
        maps = [compute_profiles(x, left[data.locate_rows(joint)], noise, SHOWN, units) for left in residuals]
        regions = [find_regions_at(prepared, left, joint, SHOWN) for left in residuals]
        standing = [seen or bool(own) for seen, own in zip(standing, regions, strict=True)]
        reach = 1.08 * max(float(np.abs(item.mean).max()) for own in maps for item in own)
        still = regions[-1] if len(maps) > 1 else []
        figures = [
            plot_profile(curves, drawn, regions[0], still, reach, f"joint-{k}") for drawn in zip(*maps, strict=True)
        ]
        found.append(Part(joint, [tuple(figures), *list_regions(curves, regions)]))
    about = (
        "The residual torque, averaged over bins of angle, velocity and time, one strip a joint, each in its own "
        f"scale. The grey band is the noise floor ({REGIONS.stands_out:g} standard errors); a shaded stretch is where "
        f"the residual stands out of it by more than {format_percent(NEGLIGIBLE)} of the joint's torque."
    )
    content: Content = [about, list_key(curves, standing[0], len(standing) > 1 and standing[-1]), *found]
    return Section("strips", "Where it fails", "Where each joint's torque is not the model's", content)
