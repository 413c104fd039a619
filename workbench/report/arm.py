"""The report of an arm: errors joint by joint, where each joint's torque is not the model's, and parameters."""

from collections.abc import Mapping, Sequence

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.diagnosis.result import Diagnosis
from estimators.signals.residual import REGIONS, compute_profiles
from estimators.weak_form.torque_windows import NEGLIGIBLE
from pendulum_env.formatting import format_percent
from workbench.narrator.diagnosis import describe_region, describe_unexplained, headline, next_step
from workbench.narrator.results import joints_table
from workbench.report.case import Case, Drawn, ends
from workbench.report.failures import key, profile_figure
from workbench.report.numbers import parameters
from workbench.report.section import Section
from workbench.report.story import ranked

SHOWN = ("position", "velocity", "time")  # a strip's plots


def sections(case: Case) -> list[Section]:
    """Build the sections of a report on an arm, for a diagnosis or a comparison."""
    found, models = case.diagnosis, ends(case.diagnosis.steps, case.first)
    measured = "held-out data" if found.searched else "the recordings compared with"
    return [
        joints(models, measured, headline(found), found.floors, found if found.searched else None),
        strips(models, case.data.parts[0]),
        *([ranked(found.candidates)] if found.candidates else []),
        parameters(case),
    ]


def joints(
    models: Sequence[Drawn],
    measured: str,
    headline: str,
    floors: Mapping[str, float],
    found: Diagnosis | None = None,
) -> Section:
    """Torque errors of every joint under each model, on the data that `measured` names, and what a diagnosis found."""
    final = models[-1][2].model
    errors = [step.errors["holdout"] for _, _, step in models]
    selected, unexplained = (found.selected, found.unexplained) if found is not None else ((), ())
    content = {
        "measured": measured,
        "table": joints_table(errors, floors, final, [label for label, _, _ in models]),
        "laws": [
            (own.id, own.law, {name: one.shown for name, one in final.get_parameters(own.id).items()})
            for own in final.terms
            if own.id in selected
        ],
        "unexplained": [describe_unexplained(found, region) for region in unexplained] if found is not None else [],
        "next_step": next_step(found) if found is not None else "",
    }
    return Section("joints", "Result", headline, content)


def strips(models: Sequence[Drawn], prepared: RegressionData) -> Section:
    """Plot the mean residual over angle, velocity and time for each joint and model."""
    curves, data = [(label, color) for label, color, _ in models], prepared.data
    residuals = [prepared.residual(step.model.terms, step.model.theta) for _, _, step in models]
    found, standing = [], [False] * len(residuals)
    for k, joint in enumerate(data.joints):
        x, noise, units = data.part(joint).samples, prepared.floors[joint], prepared.units(joint)
        maps = [compute_profiles(x, left[data.where(joint)], noise, SHOWN, units) for left in residuals]
        regions = [prepared.stand_out(left, joint, SHOWN) for left in residuals]
        standing = [seen or bool(own) for seen, own in zip(standing, regions, strict=True)]
        reach = 1.08 * max(float(np.abs(item.mean).max()) for own in maps for item in own)
        still = regions[-1] if len(maps) > 1 else []
        figures = [
            profile_figure(curves, drawn, regions[0], still, reach, f"joint-{k}") for drawn in zip(*maps, strict=True)
        ]
        standing_out = [
            {"label": label, "regions": [describe_region(region) for region in own]}
            for (label, _), own in zip(curves, regions, strict=True)
        ]
        found.append({"joint": joint, "figures": figures, "regions": standing_out})
    entries = key(curves, standing[0], len(standing) > 1 and standing[-1])
    content = {
        "strips": found,
        "key": entries,
        "threshold": REGIONS.stands_out,
        "negligible": format_percent(NEGLIGIBLE),
    }
    return Section("strips", "Where it fails", "Where each joint's torque is not the model's", content)
