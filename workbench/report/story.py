"""Sections on the result of a diagnosis, its candidates, next experiment and method."""

from typing import Any

from estimators.decisions.errors import get_single
from estimators.diagnosis.result import Diagnosis
from estimators.simulation.free_running import HORIZON
from pendulum_env.formatting import capitalise, join_words
from pendulum_env.physics.effect_texts import find_description, name_effects
from workbench.figure import Figure, make_axis, make_line
from workbench.narrator import diagnosis as narration
from workbench.narrator import results
from workbench.narrator.notes import describe_note
from workbench.narrator.parts import Code, Content, Part
from workbench.narrator.tables import JOINT_LEGEND, tabulate_joints, tabulate_parameters
from workbench.report.data import ReportData, Section


def make_story(case: ReportData) -> Section:
    """Make the section with headline, key figures and next step."""
    diagnosis = case.diagnosis
    head = {
        "lead": f"{capitalise(narration.describe_errors(diagnosis))}.",
        "torque": [step.errors["holdout"].torque_rms for step in case.ends],
        "position": [case.angle[0] * step.errors["holdout"].position_rms for step in case.ends],
        "units": (case.units.unit("N m"), case.angle[1]),
        "horizon": HORIZON,
        "refit": narration.describe_refit(diagnosis.refit) if diagnosis.refit is not None else None,
        "findings": [describe_added(diagnosis, effect) for effect in diagnosis.selected],
        "noise_floor": get_single(diagnosis.floors),
        "torque_constant": diagnosis.torque_constant,
    }
    parts = [
        *list_values(diagnosis),
        *results.narrate_disagreements(diagnosis.disagreements),
        *results.narrate_unexplained(diagnosis),
        *results.narrate_next_step(diagnosis),
    ]
    title = f"{narration.describe_result(diagnosis)}{narration.describe_unconfirmed(diagnosis, diagnosis.selected)}"
    return Section("story", "Result", title, [head, *parts])


def make_joints(case: ReportData) -> Section:
    """Make the section on an arm: added effects, torque errors of joints, unexplained residual and next step."""
    diagnosis = case.diagnosis
    errors, is_searched = [step.errors["holdout"] for step in case.ends], narration.has_searched(diagnosis)
    content: list[Any] = [
        {"findings": [describe_added(diagnosis, effect) for effect in diagnosis.selected]},
        f"{results.title_errors(errors[-1])} {'on held-out data' if is_searched else 'on all data'}",
        tabulate_joints(errors, diagnosis.floors, diagnosis.model, [label for label, _ in case.model_labels]),
        JOINT_LEGEND,
    ]
    if is_searched:
        content += [*results.narrate_unexplained(diagnosis), *results.narrate_next_step(diagnosis)]
    return Section("joints", "Result", narration.describe_result(diagnosis), content)


def list_values(diagnosis: Diagnosis) -> list[Part]:
    """List the final parameters with their values in the base model, to copy into a model; empty without an effect."""
    if not diagnosis.selected:
        return []
    lines = list[str]()
    for name, before, after, unit in tabulate_parameters(diagnosis.steps[0].model, diagnosis.model, headers="12").rows:
        notes = unit.removeprefix("1"), f"was {before.split()[0]}" if before else "new"
        lines.append(f"{name} = {after.split()[0]}  # {', '.join(filter(None, notes))}")
    about = f"Add {name_effects(diagnosis.selected)}, and use:"
    return [Part("What to change in your model", [about, Code("\n".join(lines))])]


def describe_added(diagnosis: Diagnosis, effect: str) -> dict[str, Any]:
    """Describe an added effect: its law, its sign in the residual, its final parameters, and similar effects."""
    return {
        "effect": effect,
        "law": next(term.law for term in diagnosis.model.terms if term.id == effect),
        "about": find_description(effect).signature,
        "parameters": diagnosis.model.get_parameters(effect),
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
    about = (
        f"{narration.describe_suggestion(suggestion)} `diagnose --experiment` saves it for a controller of your own."
    )
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
