"""Putting the page together: sections, style, script and plotly.js in one file."""

import base64
import gzip
import os
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs, get_plotlyjs_version

from estimators.comparison import Comparison
from estimators.diagnosis.result import Diagnosis
from estimators.selection.errors import Step
from pendulum_env.arguments import check_order
from pendulum_env.files import write_whole
from pendulum_env.formatting import (
    capitalise,
    format_number,
    format_percent,
    format_unit,
    join_words,
    split_estimate,
    typeset,
)
from workbench.narrator.comparison import caveat, errors_in_loop, headline
from workbench.narrator.diagnosis import describe_disagreement, describe_region, warnings
from workbench.narrator.effects import name
from workbench.narrator.reasons import describe_reason
from workbench.narrator.results import distances_table
from workbench.report import arm
from workbench.report.case import Case
from workbench.report.comparison import comparison, loop, of_diagnosis
from workbench.report.failures import failures
from workbench.report.numbers import errors, parameters, schemes
from workbench.report.section import Section
from workbench.report.story import candidates, method, next_experiment, story

SECTIONS: tuple[Callable[[Case], Section | None], ...] = (  # of a diagnosis, in the order in which they are read
    story,
    comparison,
    failures,
    candidates,
    next_experiment,
    errors,
    parameters,
    schemes,
    method,
)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("workbench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    formats = (capitalise, join_words, format_number, format_unit, typeset, split_estimate, format_percent)
    narrators = (caveat, describe_disagreement, describe_reason, describe_region, name, warnings)
    environment.filters |= {function.__name__: function for function in (*formats, *narrators)}
    return environment


@cache
def plotly() -> str:
    """plotly.js, packed: a third of the size, and browsers unpack it in a few hundredths of a second."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()


def render(diagnosis: Diagnosis, command: str = "") -> str:
    """HTML of the report, see `write_report`, with the command lines that do the same, if known."""
    case = Case(diagnosis, command=command)
    if not diagnosis.body.can_simulate:
        sections = arm.sections(case)
    elif diagnosis.is_in_loop:
        sections = [of_diagnosis(case), candidates(case), parameters(case)]
    else:
        sections = [section for make in SECTIONS if (section := make(case)) is not None]
    kind = "diagnosis of" if diagnosis.searched or diagnosis.findings else "comparison with"
    return _whole(case, sections, kind)


def fragment(section: Section) -> str:
    """HTML of a section's content on its own, without its figures, for another page in the same style."""
    return _environment().get_template(section.template).render(content={**section.content, "figures": []})


def shared(name: str) -> str:
    """Style or script that all pages have: `style.css`, `theme.js`, `plot.js`."""
    return _environment().get_template(name).render()


def assemble(sections: Sequence[Section], subject: str) -> str:
    """HTML of a page from its sections; the first one's title is the page's, `subject` stands above it."""
    return (
        _environment()
        .get_template("page.html")
        .render(
            sections=sections,
            title=sections[0].title,
            subject=subject,
            written=f"{datetime.now().astimezone():%d %B %Y, %H:%M}",
            plotly=plotly(),
            plotly_version=get_plotlyjs_version(),
        )
    )


def write_report(result: Diagnosis | Comparison, path: str | os.PathLike[str]) -> None:
    """Write a diagnosis or a comparison as one self-contained HTML file: it needs no network, and it prints.

    Args:
        result: with the data that it was made of.
        path: of the file, written whole or not at all.

    Raises:
        TypeError: if the arguments are in another order, or the result is another one.
        OSError: if the file cannot be written.
    """
    check_order("write_report(result, path)", (result, Diagnosis | Comparison), (path, str | os.PathLike))
    if not isinstance(result, Diagnosis | Comparison):
        raise TypeError(f"a report shows a diagnosis or a comparison, no {type(result).__name__}: compare it first")
    write_whole(Path(path), render_comparison(result) if isinstance(result, Comparison) else render(result))


def render_comparison(compared: Comparison) -> str:
    """HTML of what `compare` found of recordings, as one self-contained page like that of a diagnosis.

    It is that of a diagnosis in which nobody has looked for effects, and all is fitted and checked alike.
    """
    step = Step(None, compared.model, dict.fromkeys(("train", "holdout"), compared.joint.errors))
    found = Diagnosis(
        (step,),
        (),
        (),
        compared.regions,
        compared.joint.floors,
        (),
        torque_unit=compared.torque_unit,
        data=compared.data,
    )
    case = Case(found, first="model")  # nothing is added to it
    if not found.body.can_simulate:
        return _whole(case, arm.sections(case), "comparison with")
    distances = Section(
        "distances",
        "Result",
        headline(compared),
        {"compared": compared, "table": distances_table(compared)},
    )
    sections = [distances, comparison(case), failures(case), parameters(case)]
    if (error := errors_in_loop(compared)) is not None:
        sections.insert(1, loop(error, [("model", compared.model)], case.data.recordings, case.angle))
    return _whole(case, sections, "comparison with")


def _whole(case: Case, sections: Sequence[Section], kind: str) -> str:
    """HTML of a page about recordings."""
    return assemble(sections, f"{kind} {join_words([recording.name for recording in case.data.recordings])}")
