"""`emulate`: emulate the rig to test its commands without hardware."""

import argparse
from pathlib import Path

from pendulum_env.backends.emulators import emulate, make_serial
from pendulum_env.backends.hardware import find_adapter
from workbench import options
from workbench.options import make_plant
from workbench.outputs import check_outputs
from workbench.terminal import Terminal

RATE = 1000.0  # [Hz], reached by the serial rig
LIMITS = {  # limits of the rig's configuration on a loaded computer
    "watchdog": 0.08,  # [s]
    "gap": 0.06,  # [s], below the watchdog: the guard reports the cause
    "reply": 0.25,  # [s]
    "behind": 5.0,  # [s]
    "overruns": 1_000_000,
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare connection, plant, rate and output."""
    parser.add_argument("kind", choices=("serial",), help="connection of the drive")
    parser.add_argument(
        "-o", "--output", metavar="FILE", default="rig.toml", help="configuration to write (default rig.toml)"
    )
    parser.add_argument(
        "--rate", type=options.convert_number(10.0, 5000.0), default=RATE, help=f"of the loop [Hz] (default {RATE:g})"
    )
    options.declare(parser, *options.PLANT)


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Run the emulator until an interrupt."""
    check_outputs([arguments.output])
    find_adapter(arguments.kind)  # raises if its library is not installed

    def report(text: str) -> None:
        terminal.print(text)
        if text.startswith("ready"):
            terminal.print(
                f"try it: pendulum-ident record --backend dm1015b --config {arguments.output} --seconds 10 -o run.csv\n"
                "type hold ANGLE to turn the arm by hand [degrees], hold to let go, or quit"
            )

    emulate(
        make_serial,
        make_plant(arguments),
        Path(arguments.output),
        arguments.rate,
        {"limits": LIMITS | {"gap": max(LIMITS["gap"], 2.0 / arguments.rate)}},
        report,
    )
