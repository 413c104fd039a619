"""Sections of the page in the order in which they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pendulum_env.files import write_whole
from workbench.report.fleet.cases import cases
from workbench.report.fleet.courses import courses
from workbench.report.fleet.missing import missing
from workbench.report.fleet.siblings import siblings
from workbench.report.fleet.summary import summary
from workbench.report.page import assemble
from workbench.report.section import Section
from workbench.survey.fleet import Fleet


def render(fleet: Fleet, folder: Path, home: str | None = None) -> str:
    """HTML of the page, its links relative to the folder that it will be in; see `assemble`."""
    sections: tuple[Callable[[Fleet], Section | None], ...] = (summary, missing, courses, siblings)
    found = [section for make in sections if (section := make(fleet)) is not None]
    return assemble([*found, cases(fleet, folder)], f"survey of {len(fleet.rows)} recordings", home)


def write_fleet_report(path: str | Path, fleet: Fleet) -> None:
    """Write what a fleet shows as one HTML file, whole or not at all, with links to the pages of cases.

    Raises:
        OSError: if the file cannot be written.
    """
    write_whole(path, render(fleet, Path(path).resolve().parent))
