"""Sections of the page in the order in which they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from estimators.paper import Experiment
from pendulum_env.files import write_whole
from workbench.report.page import assemble
from workbench.report.paper.cares import cares
from workbench.report.paper.convergence import convergence
from workbench.report.paper.following import following
from workbench.report.paper.norms import norms
from workbench.report.paper.setup import departures, setup
from workbench.report.paper.table import table
from workbench.report.section import Section

SECTIONS: tuple[Callable[[Experiment], Section], ...] = (
    setup,
    table,
    cares,
    convergence,
    following,
    norms,
    departures,
)


def render(experiment: Experiment) -> str:
    """HTML of the page."""
    return assemble([make(experiment) for make in SECTIONS], "the paper's experiment, reproduced")


def write_paper_report(path: str | Path, experiment: Experiment) -> None:
    """Write the experiment as one self-contained HTML file, whole or not at all."""
    write_whole(path, render(experiment))
