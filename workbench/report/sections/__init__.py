"""Sections of the report in the order in which they are read; a new one joins by its function and its template."""

from collections.abc import Callable

from workbench.report.case import Case
from workbench.report.figure import Section
from workbench.report.sections.candidates import candidates, next_experiment
from workbench.report.sections.comparison import comparison
from workbench.report.sections.errors import errors
from workbench.report.sections.failures import failures
from workbench.report.sections.method import method
from workbench.report.sections.parameters import parameters
from workbench.report.sections.schemes import schemes
from workbench.report.sections.story import story

SECTIONS: tuple[Callable[[Case], Section | None], ...] = (
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

__all__ = ["SECTIONS"]
