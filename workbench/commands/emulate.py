"""`emulate`: a rig that is not there, to try everything without one."""

import argparse
from pathlib import Path

from pendulum_env.backends.emulators import MISHAPS, emulate, make_serial
from pendulum_env.backends.hardware.drive import find_adapter
from workbench.inputs import make_plant
from workbench.options import add_options, convert_number
from workbench.outputs import check_outputs
from workbench.terminal import Terminal

RATE = 1000.0  # [Hz], that the serial rig holds


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare kind, plant and outputs."""
    add_options(
        parser,
        f"""
        kind  how the drive is reached
        -o, --output FILE  configuration (default rig.toml)
        --effect --theta
        --rate  of the loop [Hz] (default {RATE:g})
        --log FILE  what the motor does, line by line with monotonic times
        --realtime  ask for real-time priority, here and in the loop
        --watchdog  the drive's, in the configuration [s]
        --reply  to wait for the drive, in the configuration [s]
        """,
        kind={"choices": ["serial"]},
        output={"default": "rig.toml"},
        rate=(convert_number(10.0, 5000.0), RATE),
        watchdog=(convert_number(0.005, 5.0), 0.08),
        reply=(convert_number(0.001, 5.0), 0.25),
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Run until interrupted."""
    check_outputs([arguments.output, arguments.log])
    find_adapter(arguments.kind)  # or what reaches it is not installed

    def report(text: str) -> None:
        terminal.say(text)
        if text.startswith("ready"):
            terminal.say(
                f"try it: pendulum-ident record --backend dm1015b --config {arguments.output} --seconds 10 -o run.csv\n"
                f"type a mishap to let it happen ({', '.join(MISHAPS)}), or quit"
            )

    limits = {
        "watchdog": arguments.watchdog,
        "gap": max(0.75 * arguments.watchdog, 2.0 / arguments.rate),  # before the watchdog: the guard can say why
        "reply": arguments.reply,
        "behind": 5.0,  # a machine that does other things as well is no fault
        "overruns": 1_000_000,
    }
    emulate(
        make_serial,
        make_plant(arguments),
        Path(arguments.output),
        arguments.rate,
        {"limits": limits},
        report,
        realtime=arguments.realtime,
        log=None if arguments.log is None else Path(arguments.log),
    )
