"""`survey`: a diagnosis of each of many recordings, kept in one dataset, and what they show together."""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from estimators.arguments import chosen_effects, within_limits
from pendulum_env.physics import BASE
from workbench.inputs import check_outputs, read_model, wrote
from workbench.mistakes import InputError, Interrupted
from workbench.options import LIMITS, READING, declare, number, whole
from workbench.processes import connected
from workbench.survey.cases import find_cases, joints
from workbench.survey.dataset import Dataset
from workbench.survey.fleet import Fleet
from workbench.survey.run import Tally, survey
from workbench.survey.tables import tables
from workbench.survey.work import PAGES, Settings
from workbench.terminal import Terminal

if TYPE_CHECKING:
    from distributed import Client

TABLES = (  # heading, name, and what is said where there is no row
    ("What is missing where", "missing", "nothing, in any joint"),
    ("What drifts", "drifting", "no parameter, beyond its errors and its scatter"),
    ("What changed from a date on", "jumping", ""),
    ("Joints that differ from their siblings", "odd", ""),
    ("Weak in each, present in all", "shared", ""),
)
LISTED = 20  # cases that could not be diagnosed, listed by name


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, where they are diagnosed, and outputs."""
    declare(
        parser,
        f"""
        recordings FOLDER|STUDY.toml|TABLE.csv  recordings, each diagnosed separately; a table has columns file and
            perhaps robot, joint, date, kind
        -o, --output FOLDER  folder of the dataset, continued if it exists
        --report FLEET.html  write a page about all cases of the dataset
        --reports  cases with a page of their own below FOLDER, 2 MB each: none (default), those with a finding, or all
        --names PATTERN  how paths are to be read, as '{{robot}}/{{joint}}_{{date}}', * for anything (default: folders
            are robot and joint)
        --model --only --without {LIMITS}
        --workers  processes on this computer (default 2)
        --memory MB  memory of each process (default: equal shares)
        --dask ADDRESS  scheduler of a Dask cluster to use instead, as tcp://host:8786; its workers see the same files
        {READING}
        """,
        recordings={"nargs": "+"},
        output={"required": True},
        reports={"choices": tuple(PAGES), "default": "none"},
        workers=(whole(1, 1000), 2),
        memory=number(100, 1e6),
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose what is new or changed, and tell what all cases show."""
    dataset = Dataset(Path(arguments.output))
    check_outputs([arguments.report], arguments.recordings)
    if dataset.folder.exists() and not dataset.folder.is_dir():
        raise InputError(f"{dataset.folder}: is a file: name a folder for the dataset")
    settings = _settings(arguments)
    cases = find_cases(arguments.recordings, arguments, arguments.names)
    terminal.say(f"recordings: {len(cases)}, joints: {joints(cases)}")
    with ExitStack() as stack, terminal.progress("diagnosing", timed=True) as tell:

        def connect() -> Client:
            return stack.enter_context(connected(arguments.dask, arguments.workers, arguments.memory))

        def show(tally: Tally) -> None:
            trouble = tally.new["refused"] + tally.new["failed"]
            failed = f", {trouble} could not be" if trouble else ""
            tell(f"{tally.through} of {tally.total}{failed}", tally.through / tally.total)

        try:
            tally = survey(cases, dataset, connect, settings, tell=show)
        except KeyboardInterrupt:
            raise Interrupted(f"what is done is kept in {dataset.folder}: run again to go on") from None
    _say(tally, terminal)
    _show(dataset, arguments.report, terminal)
    wrote([dataset.folder, arguments.report], terminal)


def _settings(arguments: argparse.Namespace) -> Settings:
    base = read_model(arguments.model).terms if arguments.model else BASE
    library = chosen_effects(None, arguments.only, arguments.without)
    within_limits(base, library, arguments.fixed, arguments.bounds)  # refused here rather than in every case
    asked = {"base": tuple(base), "only": tuple(library), "fixed": arguments.fixed, "bounds": arguments.bounds}
    plugins = tuple(Path(os.path.realpath(path)) for path in arguments.plugin or ())
    return Settings(asked, plugins, arguments.reports, Path(os.path.realpath(arguments.output)))


def _say(tally: Tally, terminal: Terminal) -> None:
    before = f" ({tally.known['refused']} refused)" if tally.known["refused"] else ""
    new = f"{tally.new['refused']} refused, {tally.new['failed']} failed"
    terminal.say(f"{tally.new['done']} diagnosed, {tally.known.total()} known from before{before}, {new}")
    for name, reason in tally.troubles[:LISTED]:
        terminal.say(f"- {name}: {reason}", style="yellow")
    if len(tally.troubles) > LISTED:
        terminal.say(f"and {len(tally.troubles) - LISTED} more: see status and reason in the dataset")


def _show(dataset: Dataset, report: str | None, terminal: Terminal) -> None:
    """Print what the fleet shows, and write its page."""
    fleet = Fleet.of(dataset)
    if not fleet.joints:
        terminal.say("no case could be diagnosed")
    if fleet.unexplained:
        terminal.say(f"{fleet.unexplained}: something is missing, and no known effect explains it")
    by_name = tables(fleet)
    for heading, name, otherwise in TABLES if fleet.joints else ():
        if by_name[name].rows or otherwise:
            terminal.heading(heading)
        if by_name[name].rows:
            terminal.table(*by_name[name])
        elif otherwise:
            terminal.say(otherwise)
    if report is not None:
        from workbench.survey.page import write_fleet_report  # plotly takes a while to import

        with terminal.progress("writing the page"):
            write_fleet_report(report, fleet)
