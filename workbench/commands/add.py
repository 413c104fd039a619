"""`add`: add an effect to a model, refit it, and compare the errors."""

import argparse
from pathlib import Path

from estimators.diagnosis.addition import add
from estimators.free_swings import find_scaling_values
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics.effect_texts import find_description
from pendulum_env.physics.library import find_addition
from workbench import options
from workbench.errors import InputError
from workbench.inputs import list_sources, open_sources
from workbench.narrator.diagnosis import write_addition
from workbench.narrator.results import narrate_addition
from workbench.outputs import report_files, write_json, write_model
from workbench.printing import print_parts
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, effect, recordings and output."""
    options.declare(parser, "model")
    parser.add_argument(
        "effect",
        metavar="EFFECT",
        type=options.keep_message(_convert_effect),
        help="an id that `effects` lists, of an effect or a table; of an arm ID@JOINT",
    )
    options.declare(
        parser, "recordings", *options.READING, "--holdout", "--drive", "--align", *options.LIMITS, "--degrees"
    )
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the model with the effect")
    options.add_json(parser, "write errors, tests and findings")
    options.add_robot(parser)


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Refit the model without and with the effect, and print both."""
    inputs = open_sources(arguments, list_sources(arguments, [arguments.output, arguments.json]), terminal)
    data = inputs.calibrate(terminal, arguments.align, find_scaling_values(inputs.model, arguments.fixed))
    with terminal.progress(f"adding {arguments.effect}") as progress:
        limits = {"fixed": arguments.fixed, "bounds": arguments.bounds}
        try:
            addition = add(inputs.model, arguments.effect, data.recordings, data.holdout, progress, **limits)
        except IdentificationError as error:
            if not error.effect:
                raise
            raise InputError(f"{error}: it takes {find_description(error.effect).informative_experiment}") from error
    write_json(arguments.json, write_addition(addition))
    print_parts(narrate_addition(addition), terminal)
    report_files([write_model(addition.after.model, arguments.output), arguments.json], terminal)


def _convert_effect(text: str) -> str:
    if Path(text).is_file():
        raise InputError(f"{text} is a file: the order is MODEL.json EFFECT RECORDING")
    options.find_effect(text.partition("@")[0], find_addition)
    return text
