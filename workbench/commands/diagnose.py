"""`diagnose`: which effects does the model lack?"""

import argparse
import math

from estimators.arms.transmission import find_transmissions
from estimators.diagnosis.experiment import USUAL
from estimators.diagnosis.run import diagnose
from pendulum_env.arms.recording import of_arms
from pendulum_env.excitation import MOST_TORQUE
from pendulum_env.files import write_whole
from workbench.inputs import LIMITS, READING, ROBOT, number, take, take_robot, write_json, write_model, wrote
from workbench.opened import opened
from workbench.story import MORE, tell_diagnosis
from workbench.terminal import Terminal

ASKED = ("only", "without", "fixed", "bounds", "max_torque", "max_angle", "max_speed")  # of a diagnosis, as it is


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, model to start from, and outputs."""
    take(parser, "recordings", "--holdout", *READING, "--drive", *ROBOT)
    parser.add_argument(
        "--model",
        metavar="MODEL.json",
        help="start from its terms (default: the paper's four; of an arm, friction at each joint)",
    )
    looked = "look for these effects only; of an arm at every joint, or at one, as stribeck@elbow"
    take(parser, "--only", help=looked)
    take(parser, "--without", *LIMITS, "--instruments", "--verbose")
    parser.add_argument(
        "--all", action="store_true", help="as --verbose, with every effect, also those that could not be judged"
    )
    torque = (
        f"largest torque of a suggested experiment [N m] (default {USUAL:g}, at most ten times the largest recorded)"
    )
    parser.add_argument("--max-torque", metavar="NM", type=number(0.1, MOST_TORQUE), help=torque)
    for name, unit, what in (
        ("--max-angle", "RAD", "largest angle to either side [rad]"),
        ("--max-speed", "RAD/S", "highest speed [rad/s]"),
    ):
        bound = f"its {what}, inf for any (default: as recorded)"
        parser.add_argument(name, metavar=unit, type=number(0.01, math.inf), help=bound)
    parser.add_argument("--experiment", metavar="FILE.csv", help="write the torque of the suggested experiment")
    parser.add_argument("--json", metavar="FILE", help="write the diagnosis")
    take(parser, "--report")
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the final model")
    of_pendulums = ("max_torque", "max_angle", "max_speed", "experiment", "fixed", "bounds", "instruments", "drive")
    take_robot(parser, pendulums=of_pendulums)


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Diagnose, print the story, write what is asked for."""
    from workbench.report import write_report  # plotly takes a while to import

    outputs = [arguments.experiment, arguments.json, arguments.report, arguments.output]
    asked = opened(arguments, outputs, terminal)
    given = asked.preprocessed(terminal)
    with terminal.progress("diagnosing") as progress:
        found = diagnose(
            given.recordings,
            given.holdout,
            asked.model.terms,
            progress,
            by_reference=arguments.instruments is not None,
            **{name: getattr(arguments, name) for name in ASKED},
        )
    if arguments.experiment is not None and found.suggestion is not None:
        write_whole(arguments.experiment, found.suggestion.csv())
    body = asked.body
    between = find_transmissions(of_arms(asked.recordings), body.sliding) if body is not None else ()
    more = {"transmissions": [one.json() for one in between]} if between else {}
    write_json(arguments.json, found.json() | more)
    if arguments.report is not None:
        with terminal.progress("writing the report"):
            write_report(arguments.report, found)
    for one in between:
        terminal.say(one.text)
    hint = MORE if arguments.report is None else ""
    tell_diagnosis(found, terminal, arguments.verbose or arguments.all, arguments.all, hint)
    if arguments.experiment is not None and found.suggestion is None:
        terminal.say(f"{arguments.experiment} is not written: there is no experiment")
        outputs[0] = None
    outputs[-1] = write_model(found.model, arguments.output, asked.fitted, terminal)
    wrote(outputs, terminal)
