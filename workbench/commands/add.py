"""`add`: one more effect in a model, refit, with the errors before and after."""

from __future__ import annotations

import argparse

from estimators.diagnose import add
from estimators.tables import errors_table
from pendulum_env.physics import effect
from pendulum_env.words import parameters_table
from workbench.command import Command
from workbench.inputs import (
    argument,
    check_outputs,
    keep_apart,
    read_model,
    read_recordings,
    reader,
    take_recordings,
    wrote,
)
from workbench.terminal import Terminal

FAR_ABOVE = 2.0  # times the noise floor, from which an error is no noise


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, effect, recordings and output."""
    parser.add_argument("model", metavar="MODEL.json", help="what identify, diagnose or add wrote with -o")
    parser.add_argument("effect", metavar="EFFECT", type=argument(_effect), help="an id that `effects` lists")
    take_recordings(parser, holdout=True)
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the model with the effect")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Refit the model without and with the effect; print both."""
    check_outputs([arguments.output], [*arguments.recordings, *arguments.holdout])
    keep_apart(arguments.recordings, arguments.holdout)
    model = read_model(arguments.model)
    recordings = read_recordings(arguments.recordings, reader(arguments), terminal)
    holdout = read_recordings(arguments.holdout, reader(arguments), terminal)
    with terminal.progress(f"adding {arguments.effect}") as progress:
        added = add(model, arguments.effect, recordings, holdout, progress)
    before, after = added.before, added.after
    if arguments.output is not None:
        after.model.save(arguments.output)
    terminal.heading("Errors, the model refitted without and with the effect")
    terminal.table(*errors_table((before, after)))
    terminal.say(added.text)
    left = after.errors["holdout"].torque_rms / added.noise_floor
    if left > FAR_ABOVE:
        terminal.say(
            f"what is left is {left:.1f} times the noise floor: something else is missing, `diagnose` ranks what"
        )
    terminal.heading("Parameters")
    terminal.table(*parameters_table(after.model))
    wrote([arguments.output], terminal)


def _effect(text: str) -> str:
    effect(text)
    return text


COMMAND = Command("add one effect to a model, refit it, and compare the errors", configure, run)
