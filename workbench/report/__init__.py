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
Sections = Sequence[Callable[[ReportData], Section | None]]
PENDULUM: Sections = (
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
LOOP: Sections = make_loop_diagnosis, make_recordings, make_parameters, make_candidates
ARM_IN_LOOP: Sections = make_joints, make_parameters
COMPARED: Sections = make_recordings, make_failures, make_comparison, make_parameters, make_candidates
ARM: Sections = make_joints, make_rivals, *COMPARED


def render(diagnosis: Diagnosis, command: str = "") -> str:
    """Render the report of a diagnosis as HTML; `command`: equivalent command lines, if known."""
    kind = "diagnosis of" if has_searched(diagnosis) or diagnosis.findings else "comparison with"
    return _render_sections(ReportData(diagnosis, command=command), _choose_sections(diagnosis), kind)


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
    sections = _choose_sections(diagnosis)
    if diagnosis.model.mechanism.can_simulate:
        parts, error = narrate_comparison(compared, is_drawn=True), describe_loop(compared)
        result = Section("result", "Result", describe_comparison(compared), parts)
        loop = [lambda case: make_loop(case, error)] if error is not None else []
        sections = lambda _: result, *loop, *COMPARED
    return _render_sections(case, sections, "comparison with")


def _choose_sections(diagnosis: Diagnosis) -> Sections:
    """Return the sections on a pendulum, servo or arm, in order."""
    in_loop = diagnosis.steps[0].errors["holdout"].is_of_motion
    if diagnosis.model.mechanism.can_simulate:
        return LOOP if in_loop else PENDULUM
    return ARM_IN_LOOP if in_loop else ARM


def _render_sections(case: ReportData, makers: Sections, kind: str) -> str:
    """Render a page of the sections that apply, titled by `kind` and the names of the recordings."""
    sections = [section for make in makers if (section := make(case)) is not None]
    return render_page(sections, f"{kind} {join_words([recording.name for recording in case.data.recordings])}")
