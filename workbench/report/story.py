"""Sections on the result of a diagnosis, its candidates, next experiment and method."""

from typing import Any

import numpy as np

from estimators.decisions.errors import get_single
from estimators.diagnosis.result import Diagnosis
from estimators.simulation.free_running import HORIZON
from pendulum_env.formatting import capitalise, format_number, join_words
from pendulum_env.physics.effect_texts import name_effect
from workbench.figure import Figure, make_axis, make_line
from workbench.narrator import results
from workbench.narrator.diagnosis import (
    describe_errors,
    describe_refit,
    describe_result,
    describe_suggestion,
    has_searched,
)
from workbench.narrator.notes import describe_note
from workbench.narrator.parts import Code, Content, Part
from workbench.narrator.tables import JOINT_LEGEND, tabulate_joints
from workbench.report.data import ReportData, Section


def make_story(case: ReportData) -> Section:
    """Make the section with headline, key figures and next step."""
    diagnosis = case.diagnosis
    constant = diagnosis.torque_constant
    head = {
        "lead": f"{capitalise(describe_errors(diagnosis))}.",
        "changes": list_changes(case),
        "misled": list_biased_parameters(diagnosis),
        "refit": describe_refit(diagnosis.refit) if diagnosis.refit is not None else None,
        "findings": [describe_added(diagnosis, effect) for effect in diagnosis.selected],
        "noise_floor": get_single(diagnosis.floors),
        "reached": diagnosis.steps[-1].errors["holdout"].torque_rms / get_single(diagnosis.floors),
        "torque_constant": constant.text if constant is not None else None,
    }
    parts = [
        *results.narrate_disagreements(diagnosis.disagreements),
        *results.narrate_unexplained(diagnosis),
        *results.narrate_next_step(diagnosis),
    ]
    return Section("story", "Result", describe_result(diagnosis), [head, *parts])


def make_joints(case: ReportData) -> Section:
    """Make the section on an arm: added effects, torque errors of joints, unexplained residual and next step."""
    diagnosis = case.diagnosis
    selected = tuple(
        f"{term.id}: {term.law}; "
        + ", ".join(f"{name} {estimate.shown}" for name, estimate in diagnosis.model.get_parameters(term.id).items())
        for term in diagnosis.model.terms
        if term.id in diagnosis.selected
    )
    errors = [step.errors["holdout"] for step in case.ends]
    content: list[Any] = [
        *([Part("Added effects", [selected])] if selected else []),
        f"{results.title_errors(errors[-1])} {'on held-out data' if has_searched(diagnosis) else 'on all data'}",
        tabulate_joints(errors, diagnosis.floors, diagnosis.model, [label for label, _ in case.model_labels]),
        JOINT_LEGEND,
    ]
    if has_searched(diagnosis):
        content += [*results.narrate_unexplained(diagnosis), *results.narrate_next_step(diagnosis)]
    return Section("joints", "Result", describe_result(diagnosis), content)


def list_changes(case: ReportData) -> list[dict[str, Any]]:
    """List the held-out errors before and after; `share`: after over before, None if no effect was added."""
    diagnosis, (factor, angle) = case.diagnosis, case.angle
    first, last = (diagnosis.steps[k].errors["holdout"] for k in (0, -1))
    over = f"on held-out data, over {HORIZON:g} s"
    changes: list[dict[str, Any]] = [
        {"label": "Torque error", "unit": case.units.unit("N m"), "note": "on held-out data"},
        {"label": "Free-running position error", "unit": angle, "note": over},
    ]
    pairs = (first.torque_rms, last.torque_rms), (factor * first.position_rms, factor * last.position_rms)
    for change, (before, after) in zip(changes, pairs, strict=True):
        share = after / before if diagnosis.selected and not np.isnan(after) else None
        change |= {"before": before, "after": after, "share": share}
    return changes


def list_biased_parameters(diagnosis: Diagnosis) -> list[str]:
    """List the parameters that missing effects biased by more than 1 % and three standard errors.

    The list is empty with an unexplained residual, because the final parameters may be biased, too.
    """
    wrong_by: list[str] = []
    if diagnosis.unexplained:
        return wrong_by
    for parameter, first in diagnosis.steps[0].model.estimates.items():
        final = diagnosis.model.estimates.get(parameter)
        if final is None or final.value == 0:
            continue
        share, off = first.value / final.value - 1.0, abs(first.value - final.value)
        if abs(share) >= 0.01 and off > 3.0 * float(np.hypot(first.std, final.std)):
            wrong_by.append(
                f"{name_effect(parameter)} {format_number(100 * abs(share), 2)} % too {'high' if share > 0 else 'low'}"
            )
    return wrong_by


def describe_added(diagnosis: Diagnosis, effect: str) -> dict[str, Any]:
    """Describe an added effect: its law, its final parameters, and similar effects."""
    term = next(term for term in diagnosis.model.terms if term.id == effect)
    names = [column.name for column in term.columns] + [f"{term.id}.{parameter.name}" for parameter in term.free]
    named = {**diagnosis.model.estimates, **diagnosis.model.derived}
    names += [name for name in diagnosis.model.derived if name.startswith(f"{effect}.")]
    about = (type(term).__doc__ or "").split("\n")[0].split(":")[0]  # first line, without the formula
    return {
        "effect": effect,
        "law": term.law,
        "about": "" if about.startswith(f"{type(term).__name__}(") else about.rstrip("."),
        "parameters": {name: named[name].shown for name in names},
        "rivals": [id for group in diagnosis.ambiguous if group[0] == effect for id in group[1:]],
    }


def make_next_experiment(case: ReportData) -> Section | None:
    """Make the section on the next experiment; None without one."""
    suggestion = case.diagnosis.suggestion
    if suggestion is None or suggestion.signal is None:
        return None
    (time, torque), unit = suggestion.samples(), case.units.unit("N m")
    figure = Figure(
        "next-torque",
        "torque of the suggested experiment over time",
        [make_line(time, torque, "torque", "--final", unit)],
        {"xaxis": make_axis("time [s]"), "yaxis": make_axis(f"torque [{unit}]"), "showlegend": False},
        height=220,
    )
    about = f"{describe_suggestion(suggestion)} `diagnose --experiment` saves it for a controller of your own."
    return Section("next", "What next", "The next experiment", [about, figure])


def make_method(case: ReportData) -> Section:
    """Make the section on the method."""
    terms = join_words([term.id for term in case.diagnosis.steps[0].model.terms])
    split = "" if case.data.holdout else " Held out is the last 30 % of each recording."
    recordings = case.data.all_recordings
    content: Content = [
        f"The base model has the terms {terms}. Its torque balance is averaged over short smooth windows clear of "
        "stick, which passes both sides through the same filter, and solved by least squares. Standard errors allow "
        "for residuals that are correlated in time. An effect must predict blocks of the fitted data that it was not "
        "fitted to. It must then lower the error on held-out data, in torque and in free-running simulation over "
        f"{HORIZON:g} s.{split}",
        tuple(
            dict.fromkeys(
                f"{recording.name}: {describe_note(note)}" for recording in recordings for note in recording.notes
            )
        ),
        *([Part("Do it again", [Code(case.command)])] if case.command else []),
    ]
    return Section("method", "Method", "How this was done", content)
