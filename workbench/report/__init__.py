"""Report of a diagnosis or a comparison as one self-contained HTML file."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from estimators.decisions.errors import Step
from estimators.diagnosis.result import Diagnosis
from estimators.results import Comparison
from pendulum_env.files import write_whole
from pendulum_env.formatting import join_words
from workbench.narrator.diagnosis import describe_comparison, describe_loop, has_searched
from workbench.narrator.results import narrate_comparison
from workbench.report.comparison import make_comparison, make_loop, make_loop_diagnosis
from workbench.report.data import ReportData, Section
from workbench.report.evidence import make_candidates
from workbench.report.failures import make_failures
from workbench.report.matches import make_rivals
from workbench.report.numbers import make_errors, make_parameters, make_schemes
from workbench.report.page import render_page
from workbench.report.recordings import make_recordings
from workbench.report.story import make_joints, make_method, make_next_experiment, make_story

__all__ = ["render", "render_comparison", "write_report"]
SECTIONS: tuple[Callable[[ReportData], Section | None], ...] = (  # of a diagnosis, in order
    make_story,
    make_rivals,
    make_recordings,
    make_failures,
    make_comparison,
    make_errors,
    make_parameters,
    make_candidates,
    make_next_experiment,
    make_schemes,
    make_method,
)


def render(diagnosis: Diagnosis, command: str = "") -> str:
    """Render the report of a diagnosis as HTML; `command`: equivalent command lines, if known."""
    case = ReportData(diagnosis, command=command)
    if not diagnosis.model.mechanism.can_simulate:
        sections = _make_arm_sections(case)
    elif diagnosis.steps[0].errors["holdout"].is_of_motion:
        sections = [make_loop_diagnosis(case), make_recordings(case), make_parameters(case), make_candidates(case)]
    else:
        sections = [section for make in SECTIONS if (section := make(case)) is not None]
    kind = "diagnosis of" if has_searched(diagnosis) or diagnosis.findings else "comparison with"
    return _render_recordings(case, sections, kind)


def write_report(result: Diagnosis | Comparison, path: str | os.PathLike[str]) -> None:
    """Write a diagnosis or a comparison as one self-contained HTML file.

    Raises:
        TypeError: if the result is of another type.
        OSError: if the file cannot be written.
    """
    if not isinstance(result, Diagnosis | Comparison):
        raise TypeError(f"a report shows a diagnosis or a comparison, no {type(result).__name__}: compare it first")
    write_whole(Path(path), render_comparison(result) if isinstance(result, Comparison) else render(result))


def render_comparison(compared: Comparison) -> str:
    """Render a comparison as HTML: the page of a diagnosis without a search."""
    step = Step(None, compared.model, dict.fromkeys(("train", "holdout"), compared.joint.errors))
    diagnosis = Diagnosis((step,), (), (), compared.regions, compared.joint.floors, (), data=compared.data)
    case = ReportData(diagnosis, first="model")
    if not diagnosis.model.mechanism.can_simulate:
        return _render_recordings(case, _make_arm_sections(case), "comparison with")
    parts = narrate_comparison(compared, is_drawn=True)
    result = Section("result", "Result", describe_comparison(compared), parts)
    sections = [result, make_recordings(case), make_failures(case), make_comparison(case), make_parameters(case)]
    if (error := describe_loop(compared)) is not None:
        sections.insert(1, make_loop(case, error))
    return _render_recordings(case, sections, "comparison with")


def _make_arm_sections(case: ReportData) -> list[Section]:
    """Make the sections on an arm for a diagnosis or a comparison."""
    if case.diagnosis.steps[0].errors["holdout"].is_of_motion:
        return [make_joints(case), make_parameters(case)]
    candidates = [make_candidates(case)] if case.diagnosis.candidates else []
    rivals = [why] if (why := make_rivals(case)) is not None else []
    first = make_joints(case), *rivals, make_recordings(case)
    return [*first, make_failures(case), make_comparison(case), make_parameters(case), *candidates]


def _render_recordings(case: ReportData, sections: Sequence[Section], kind: str) -> str:
    """Render a page titled by `kind` and the names of the recordings."""
    return render_page(sections, f"{kind} {join_words([recording.name for recording in case.data.recordings])}")
