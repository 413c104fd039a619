"""`survey`: a diagnosis of each of many recordings, kept in one dataset, and what they show together."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from estimators.arguments import chosen_effects, within_limits
from pendulum_env.physics import BASE
from workbench.inputs import check_outputs, ids, number, read_model, take_limits, take_reading, whole, wrote
from workbench.mistakes import MISTAKES, InputError, sentence
from workbench.survey.cases import Case, find_cases, joints
from workbench.survey.cluster import connected
from workbench.survey.dataset import Dataset
from workbench.survey.fleet import Fleet
from workbench.survey.run import Tally, survey, watch
from workbench.survey.tables import drifting_table, effects_table, jumping_table, odd_table, pooled_table
from workbench.survey.work import Settings
from workbench.terminal import Terminal

if TYPE_CHECKING:
    from distributed import Client

PAGES = ("none", "found", "all")
LISTED = 20  # cases that could not be diagnosed, told by name
EVERY = 10.0  # [s]


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, where they are diagnosed, and outputs."""
    parser.add_argument(
        "recordings",
        metavar="FOLDER|GLOB|STUDY.toml|TABLE.csv",
        nargs="+",
        help="recordings, each diagnosed by itself; a table has a column file and perhaps robot, joint, date and kind",
    )
    parser.add_argument("-o", "--output", metavar="FOLDER", required=True, help="dataset, gone on with if it is there")
    parser.add_argument("--report", metavar="FLEET.html", help="write a page on all cases of the dataset")
    parser.add_argument(
        "--reports",
        choices=PAGES,
        default="none",
        help="cases that get a page of their own below FOLDER, 2 MB each: none, those where something is found, or all "
        "(default none)",
    )
    parser.add_argument(
        "--names",
        metavar="PATTERN",
        help="what names of files mean, as '{robot}/{joint}_{date}', * for anything; by default folders tell robot and "
        "joint, and a date in the name when",
    )
    parser.add_argument("--model", metavar="MODEL.json", help="start from its terms (default: the paper's four)")
    parser.add_argument("--only", metavar="ID,...", type=ids, help="look for these effects alone")
    parser.add_argument("--without", metavar="ID,...", type=ids, default=[], help="do not look for these effects")
    take_limits(parser)
    parser.add_argument("--workers", type=whole(1, 1000), default=2, help="processes here (default 2)")
    parser.add_argument("--memory", type=number(100, 1e6), metavar="MB", help="of each (default: equal shares)")
    parser.add_argument(
        "--dask", metavar="ADDRESS", help="scheduler of a Dask cluster to work on instead, as tcp://host:8786; its "
        "workers see the same files"
    )  # fmt: skip
    parser.add_argument("--watch", action="store_true", help="go on, and take in files that come, until Ctrl-C")
    parser.add_argument(
        "--every", type=number(0.1, 86400), default=EVERY, metavar="S", help=f"between looks (default {EVERY:g} s)"
    )
    take_reading(parser)


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose what is new or changed, and tell what all cases show."""
    dataset = Dataset(Path(arguments.output))
    check_outputs([arguments.report], arguments.recordings)
    if dataset.folder.exists() and not dataset.folder.is_dir():
        raise InputError(f"{dataset.folder}: is a file: name a folder for the dataset")
    base = read_model(arguments.model).terms if arguments.model else BASE
    library = chosen_effects(None, arguments.only, arguments.without)
    within_limits(base, library, arguments.fixed, arguments.bounds)  # refused here rather than in every case
    settings = Settings(
        tuple(base),
        library=tuple(library),
        fixed=arguments.fixed,
        bounds=arguments.bounds,
        plugins=tuple(Path(path).resolve() for path in arguments.plugin or ()),
        reports=arguments.reports,
        folder=dataset.folder.resolve(),
    )

    said: set[tuple[str, str]] = set()  # of what could not be diagnosed: it is told once

    def find() -> list[Case]:
        return find_cases(arguments.recordings, arguments, arguments.names)

    if not arguments.watch:
        cases = find()
        terminal.say(f"recordings: {len(cases)}, joints: {joints(cases)}")
    with ExitStack() as stack:

        @cache
        def client() -> Client:
            return stack.enter_context(connected(arguments.dask, arguments.workers, arguments.memory))

        def work(cases: Sequence[Case]) -> None:
            with terminal.counting("diagnosing") as tell:
                try:
                    tally = survey(cases, dataset, client, settings, tell=_telling(tell))
                except KeyboardInterrupt:
                    terminal.say(f"what is done is kept in {dataset.folder}: run again to go on")
                    raise
            _say(tally, said, terminal)
            if tally.through > tally.unchanged or not arguments.watch:
                _show(dataset, arguments.report, terminal)

        if not arguments.watch:
            work(cases)
        else:
            try:
                watch(_patient(find, terminal), work, arguments.every)
            except KeyboardInterrupt:
                terminal.say("stopped watching")
    wrote([dataset.folder, arguments.report], terminal)


def _patient(find: Callable[[], list[Case]], terminal: Terminal) -> Callable[[], list[Case]]:
    """Look again later where a name or a table makes no sense yet: it may be half written. Each reason is said once."""
    said: set[str] = set()

    def found() -> list[Case]:
        try:
            return find()
        except MISTAKES as mistake:
            if (reason := sentence(mistake)) not in said:
                said.add(reason)
                terminal.say(f"waiting: {reason}", style="yellow")
            return []

    return found


def _telling(tell: Callable[[int, int, str], None]) -> Callable[[Tally], None]:
    def told(tally: Tally) -> None:
        trouble = tally.refused + tally.failed
        tell(tally.through, tally.total, f"{trouble} could not be" if trouble else "")

    return told


def _say(tally: Tally, said: set[tuple[str, str]], terminal: Terminal) -> None:
    known = f"{tally.unchanged} known from before" + f" ({tally.refused_before} refused)" * (tally.refused_before > 0)
    terminal.say(f"{tally.done} diagnosed, {known}, {tally.refused} refused, {tally.failed} failed")
    troubles = [trouble for trouble in tally.troubles if trouble not in said]
    said.update(troubles)
    for name, reason in troubles[:LISTED]:
        terminal.say(f"- {name}: {reason}", style="yellow")
    if len(troubles) > LISTED:
        terminal.say(f"and {len(troubles) - LISTED} more: see status and reason in the dataset")


def _show(dataset: Dataset, report: str | None, terminal: Terminal) -> None:
    """Print what the fleet shows, and write its page."""
    fleet = Fleet.of(dataset)
    terminal.heading("What is missing where")
    if fleet.effects:
        terminal.table(*effects_table(fleet))
    else:
        terminal.say("nothing, in any joint")
    terminal.heading("What drifts")
    if fleet.drifting:
        terminal.table(*drifting_table(fleet))
    else:
        terminal.say("no parameter, beyond its errors and its scatter")
    if fleet.jumping:
        terminal.heading("What changed from a date on")
        terminal.table(*jumping_table(fleet))
    if fleet.odd:
        terminal.heading("Joints that differ from their siblings")
        terminal.table(*odd_table(fleet))
    if fleet.shared:
        terminal.heading("Weak in each, present in all")
        terminal.table(*pooled_table(fleet))
    if report is not None:
        from workbench.report.fleet import write_fleet_report  # plotly takes a while to import

        with terminal.progress("writing the page"):
            write_fleet_report(report, fleet)
