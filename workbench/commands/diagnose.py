"""`diagnose`: which effects does the model lack?"""

from __future__ import annotations

import argparse
import json
import math

from estimators.design import USUAL
from estimators.diagnose import diagnose
from pendulum_env.files import write_whole
from pendulum_env.physics import BASE
from workbench.command import Command
from workbench.commands.identify import six_schemes
from workbench.inputs import (
    check_outputs,
    keep_apart,
    number,
    read_model,
    read_recordings,
    reader,
    take_recordings,
    wrote,
)
from workbench.story import tell
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, model to start from, and outputs."""
    take_recordings(parser, holdout=True)
    parser.add_argument("--model", metavar="MODEL.json", help="start from its terms (default: the paper's four)")
    parser.add_argument(
        "--max-torque",
        metavar="NM",
        type=number(0.1),
        help=f"bound of the torque of a suggested experiment [N m] (default {USUAL:g}, or the largest recorded)",
    )
    parser.add_argument(
        "--max-angle",
        metavar="RAD",
        type=number(0.01),
        default=math.inf,
        help="bound of its angle to either side [rad]",
    )
    parser.add_argument(
        "--max-speed", metavar="RAD/S", type=number(0.01), default=math.inf, help="bound of its speed [rad/s]"
    )
    parser.add_argument("--json", metavar="FILE", help="write the diagnosis")
    parser.add_argument("--report", metavar="FILE.html", help="write a report with plots, one file to share")
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the final model")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose, print the story, write what is asked for."""
    from workbench.report import write_report  # plotly takes a while to import

    outputs = [arguments.json, arguments.report, arguments.output]
    check_outputs(outputs, [*arguments.recordings, *arguments.holdout])
    keep_apart(arguments.recordings, arguments.holdout)
    base = read_model(arguments.model).terms if arguments.model else BASE
    recordings = read_recordings(arguments.recordings, reader(arguments), terminal)
    holdout = read_recordings(arguments.holdout, reader(arguments), terminal)
    with terminal.progress("diagnosing") as progress:
        found = diagnose(
            recordings, holdout, base, progress, arguments.max_torque, arguments.max_angle, arguments.max_speed
        )
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(found.json(), indent=1) + "\n")
    if arguments.output is not None:
        found.model.save(arguments.output)
    if arguments.report is not None:
        with terminal.progress("writing the report"):
            schemes = six_schemes(recordings, found.model.terms)
            write_report(arguments.report, recordings, holdout, found, schemes)
    tell(found, terminal)
    wrote(outputs, terminal)


COMMAND = Command("find the effects that a model lacks, and add them", configure, run)
