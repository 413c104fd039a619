"""`add`: one more effect in a model, refit, with the errors before and after."""

import argparse
from pathlib import Path

from estimators.diagnosis.addition import add
from estimators.free_swings import find_scaling_values
from estimators.regression.equations import IdentificationError
from pendulum_env.physics.library import find_addition
from workbench.inputs import opened
from workbench.mistakes import InputError
from workbench.narrator.effects import description
from workbench.narrator.results import of_addition
from workbench.options import LIMITS, READING, ROBOT, declare, known_effect
from workbench.outputs import write_model, wrote
from workbench.story import tell
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, effect, recordings and output."""
    declare(
        parser,
        f"""
        model
        effect EFFECT  an id that `effects` lists, of an effect or a table; of an arm ID@JOINT
        recordings --holdout {READING} --drive {ROBOT} --align {LIMITS} --degrees
        -o, --output MODEL.json  write the model with the effect
        """,
        effect=_effect,
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Refit the model without and with the effect; print both."""
    asked = opened(arguments, [arguments.output], terminal)
    given = asked.preprocessed(terminal, arguments.align, find_scaling_values(asked.model, arguments.fixed))
    with terminal.progress(f"adding {arguments.effect}") as progress:
        limits = {"fixed": arguments.fixed, "bounds": arguments.bounds}
        try:
            added = add(asked.model, arguments.effect, given.recordings, given.holdout, progress, **limits)
        except IdentificationError as error:
            if not error.effect:
                raise
            raise InputError(f"{error}: it takes {description(error.effect).informative_experiment}") from error
    tell(of_addition(added), terminal)
    wrote([write_model(added.after.model, arguments.output, terminal)], terminal)


def _effect(text: str) -> str:
    if Path(text).is_file():
        raise argparse.ArgumentTypeError(f"{text} is a file: the order is MODEL.json EFFECT RECORDING")
    known_effect(text.partition("@")[0], find_addition)
    return text
