"""`hardware check`: the first hours with a rig."""

import argparse

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.config import load
from workbench.errors import InputError
from workbench.rig_check import CheckFailed, check_rig
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare what to do with which rig."""
    parser.add_argument("what", choices=("check",), help="wiring, signs, zero and limits, step by step at low torque")
    parser.add_argument("config", metavar="CONFIG", help="the rig's rig.toml, see docs/hardware.md")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Go through the check with the user at the terminal."""

    def confirm(text: str) -> bool:
        """Ask until they say yes or no: a key that is pressed once too often moves no motor."""
        terminal.say(text)
        try:
            while (answer := input("[y/n] ").strip().lower()) not in ("y", "yes", "n", "no"):
                pass
            return answer.startswith("y")
        except EOFError:
            raise InputError("the check asks questions: run it in a terminal") from None

    try:
        check_rig(load(arguments.config), terminal.say, confirm)
    except (CheckFailed, DriveError) as error:
        raise InputError(str(error)) from None
