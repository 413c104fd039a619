"""The report of a comparison: how far a model is from recordings, and where."""

from __future__ import annotations

from pathlib import Path

from estimators.arguments import Recordings, chosen_recordings
from estimators.comparison import Comparison, in_units_of, joined
from estimators.diagnosis.result import Diagnosis
from estimators.selection.data import Evidence, Step
from pendulum_env import words
from pendulum_env.files import write_whole
from workbench.report.case import Case
from workbench.report.page import assemble
from workbench.report.section import Section
from workbench.report.sections.comparison import comparison
from workbench.report.sections.failures import failures
from workbench.report.sections.loop import loop
from workbench.report.sections.parameters import parameters


def write_comparison_report(path: str | Path, compared: Comparison, recordings: Recordings) -> None:
    """Write a comparison as one self-contained HTML file, like that of a diagnosis.

    Args:
        path: of the file, written whole or not at all.
        compared: what `compare` found.
        recordings: what it was given.

    Raises:
        OSError: if the file cannot be written.
    """
    write_whole(path, render(compared, recordings))


def render(compared: Comparison, recordings: Recordings) -> str:
    """HTML of the report; see `write_comparison_report`."""
    case = _case(compared, recordings)
    sections = [distances(compared), comparison(case), failures(case), parameters(case)]
    if compared.told_in_loop is not None:
        own = in_units_of(compared.model, chosen_recordings(recordings))
        sections.insert(1, loop(compared.told_in_loop, [("model", compared.model)], own))
    page = assemble(sections, f"comparison with {words.listing([recording.name for recording in case.train])}")
    return words.per(page, compared.torque_unit)


def distances(compared: Comparison) -> Section:
    """Errors on every recording, and what they mean."""
    headline = words.opening(compared.headline).replace(" N m", "\u00a0N\u00a0m").replace(" rad", "\u00a0rad")
    return Section("distances", "Result", headline, {"compared": compared})


def _case(compared: Comparison, recordings: Recordings) -> Case:
    """The comparison as a diagnosis in which nobody has looked for effects."""
    own = in_units_of(compared.model, chosen_recordings(recordings))
    together = joined([Evidence.of([recording]) for recording in own])
    errors = compared.joint.errors
    step = Step(None, compared.model, {"train": errors, "holdout": errors})
    told = Diagnosis((step,), (), (), compared.regions, compared.joint.noise_floor, ())
    return Case(own, own, False, told, gathered=(together, together), first="model")  # nothing is added to it
