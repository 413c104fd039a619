"""Putting the page together: sections, style, script and plotly.js in one file."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from datetime import datetime
from functools import cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs, get_plotlyjs_version

from estimators.arguments import Recordings, chosen_recordings
from estimators.comparison import Comparison, in_units_of, joined
from estimators.diagnosis.result import Diagnosis
from estimators.selection.data import PreparedData
from estimators.selection.errors import Step
from pendulum_env import words
from pendulum_env.files import write_whole
from workbench.report.case import Case
from workbench.report.figure import Section
from workbench.report.sections import SECTIONS
from workbench.report.sections.candidates import candidates
from workbench.report.sections.comparison import comparison
from workbench.report.sections.failures import failures
from workbench.report.sections.loop import loop, of_diagnosis
from workbench.report.sections.parameters import parameters


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("workbench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "name": words.name,
        "opening": words.opening,
        "listing": words.listing,
        "number": words.number,
        "unit": words.unit,
        "estimate": words.estimate,
        "value_and_error": words.value_and_error,
        "percent": words.percent,
        "duration": words.duration,
    }
    return environment


@cache
def plotly() -> str:
    """plotly.js, packed: a third of the size, and browsers unpack it in a few hundredths of a second."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()


def render(recordings: Recordings, holdout: Recordings, diagnosis: Diagnosis) -> str:
    """HTML of the report; see `write_report`."""
    fitted, unseen = chosen_recordings(recordings), chosen_recordings(holdout, empty=True)
    case = Case.of(fitted, unseen, diagnosis)
    if diagnosis.is_in_loop:
        sections = [of_diagnosis(diagnosis, fitted, unseen), candidates(case), parameters(case)]
    else:
        sections = [section for make in SECTIONS if (section := make(case)) is not None]
    page = assemble(sections, f"diagnosis of {words.listing([recording.name for recording in case.train])}")
    return words.per(page, diagnosis.torque_unit)


def fragment(section: Section) -> str:
    """HTML of a section's content on its own, without its figures, for another page in the same style."""
    content = {name: value for name, value in section.content.items() if name != "figures"} | {"figures": []}
    return _environment().get_template(section.template).render(content=content)


def shared(name: str) -> str:
    """Style or script that all pages have: `style.css`, `theme.js`, `plot.js`."""
    return _environment().get_template(name).render()


def assemble(sections: Sequence[Section], subject: str, home: str | None = None) -> str:
    """HTML of a page from its sections; the first one's title is the page's, `subject` stands above it.

    `home` is the address of the workbench, for a page that it serves.
    """
    return (
        _environment()
        .get_template("page.html")
        .render(
            sections=sections,
            title=sections[0].title,
            subject=subject,
            home=home,
            written=f"{datetime.now().astimezone():%d %B %Y, %H:%M}",
            plotly=plotly(),
            plotly_version=get_plotlyjs_version(),
        )
    )


def write_report(path: str | Path, recordings: Recordings, holdout: Recordings, diagnosis: Diagnosis) -> None:
    """Write a diagnosis as one self-contained HTML file: it needs no network and no other file, and it prints.

    Args:
        path: of the file, written whole or not at all.
        recordings: what the diagnosis was made from.
        holdout: what it was confirmed on; empty if the end of each recording was held out.
        diagnosis: what was found.

    Raises:
        TypeError: if something else is given than recordings.
        OSError: if the file cannot be written.
    """
    write_whole(path, render(recordings, holdout, diagnosis))


def render_comparison(compared: Comparison, recordings: Recordings) -> str:
    """HTML of what `compare` found of recordings, as one self-contained page like that of a diagnosis."""
    case = _case(compared, recordings)
    headline = words.opening(compared.headline).replace(" N m", "\u00a0N\u00a0m").replace(" rad", "\u00a0rad")
    distances = Section("distances", "Result", headline, {"compared": compared})
    sections = [distances, comparison(case), failures(case), parameters(case)]
    if compared.told_in_loop is not None:
        own = in_units_of(compared.model, chosen_recordings(recordings))
        sections.insert(1, loop(compared.told_in_loop, [("model", compared.model)], own))
    page = assemble(sections, f"comparison with {words.listing([recording.name for recording in case.train])}")
    return words.per(page, compared.torque_unit)


def _case(compared: Comparison, recordings: Recordings) -> Case:
    """The comparison as a diagnosis in which nobody has looked for effects."""
    own = in_units_of(compared.model, chosen_recordings(recordings))
    together = joined([PreparedData.of([recording]) for recording in own])
    errors = compared.joint.errors
    step = Step(None, compared.model, {"train": errors, "holdout": errors})
    found = Diagnosis((step,), (), (), compared.regions, compared.joint.noise_floor, ())
    return Case(own, own, False, found, gathered=(together, together), first="model")  # nothing is added to it
