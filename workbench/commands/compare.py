"""`compare`: a model against recordings."""

import argparse

from estimators.comparison import compare, in_units_of
from estimators.in_loop.rollouts import are_driven
from estimators.show.story import of_comparison
from pendulum_env.arms.joints import links_of
from pendulum_env.files import write_whole
from workbench.arms import carried, of_payload
from workbench.inputs import KINDS, READING, ROBOT, check_outputs, take, take_robot, write_json, wrote
from workbench.mistakes import InputError
from workbench.opened import opened, tell_preprocessed
from workbench.story import tell
from workbench.terminal import Terminal

LAST = ""  # joint of a payload, if none is named


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, recordings and output."""
    take(parser, "model")
    take(parser, "recordings", help=f"{KINDS}; each compared with the model")
    take(parser, *READING, "--drive", "--align", "--report")
    parser.add_argument(
        "--loop",
        action="store_true",
        help="simulate whole recordings in closed loop from their reference, which needs --drive or a study with "
        "[drive]; if a drive is known, these errors are given anyway",
    )
    take(parser, *ROBOT)
    parser.add_argument(
        "--payload",
        metavar="JOINT",
        nargs="?",
        const=LAST,
        help="with --robot: identify the load that the arm carries in these recordings, at the link behind JOINT "
        "(default: the last)",
    )
    parser.add_argument(
        "--without",
        metavar="RECORDING",
        action="append",
        default=[],
        help="with --payload: a recording without the load (may be repeated), to which the model is refitted",
    )
    parser.add_argument("--json", metavar="FILE", help="write errors, profiles and regions")
    take_robot(parser, arms=("payload", "without"), pendulums=("align", "loop", "drive"))


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the errors of the model, and where they are."""
    if arguments.without and arguments.payload is None:
        raise InputError("--without is of the arm without its payload: say --payload, too")
    outputs = [arguments.json, arguments.report]
    check_outputs(outputs, [arguments.model])
    asked = opened(arguments, outputs, terminal)
    model, recordings = asked.model, [*asked.recordings, *asked.holdout]
    if arguments.loop and not are_driven(recordings):
        raise InputError(
            f"{recordings[0].name}: nobody knows its controller: say it with --drive, or [drive] in a study"
        )
    if asked.body is None:
        given = tell_preprocessed(in_units_of(model, recordings), arguments.align, terminal)
        recordings = list(given.recordings)
    with terminal.progress("comparing"):
        found = compare(model, recordings)
    payload, suspected = None, None
    if asked.body is not None:
        payload = carried(arguments, asked, recordings, terminal)
        payload, suspected = (None, payload) if arguments.payload is None else (payload, None)
    write_json(arguments.json, found.json() | ({} if payload is None else {"payload": payload.json()}))
    if arguments.report is not None:
        from workbench.report import render_comparison  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_whole(arguments.report, render_comparison(found))
    tell(of_comparison(found), terminal)
    if payload is not None:
        tell(of_payload(payload, links_of(model.terms)), terminal)
    if suspected is not None and suspected.stands_out:
        mass = suspected.estimates["m"].text
        terminal.say(f"\nA payload of {mass} kg behind {suspected.joint} would explain most of it: see --payload")
    wrote(outputs, terminal)
