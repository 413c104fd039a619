"""`add`: one more effect in a model, refit, with the errors before and after."""

from __future__ import annotations

import argparse

from estimators.diagnosis.addition import add
from estimators.show.tables import errors_table
from pendulum_env.physics.library import addition
from pendulum_env.words import parameters_table
from workbench.inputs import (
    argument,
    check_outputs,
    given,
    in_time,
    in_torque,
    known_effect,
    of_pendulums,
    read_model,
    read_recordings,
    refuse_joint,
    take_align,
    take_limits,
    take_recordings,
    take_robot,
    write_model,
    wrote,
)
from workbench.terminal import Terminal

FAR_ABOVE = 2.0  # times the noise floor, from which an error is no noise


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, effect, recordings and output."""
    parser.add_argument("model", metavar="MODEL.json", help="what identify, diagnose or add wrote with -o")
    parser.add_argument(
        "effect",
        metavar="EFFECT",
        type=argument(_effect),
        help="an id that `effects` lists, of an effect or a table; of an arm ID@JOINT",
    )
    take_recordings(parser, holdout=True)
    take_robot(parser)
    take_align(parser)
    take_limits(parser)
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the model with the effect")
    of_pendulums(parser, "align", "fixed", "bounds", "drive")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Refit the model without and with the effect; print both."""
    if arguments.robot is not None:
        from workbench import arms  # Pinocchio is imported by who needs it

        arms.add(arguments, terminal)
        return
    refuse_joint(arguments.effect)
    asked = given(arguments)
    check_outputs([arguments.output], asked.files)
    model = read_model(arguments.model)
    asked = asked.read_as(model.log_format, arguments.model)
    recordings, holdout = (read_recordings(part, terminal) for part in (asked.fitted, asked.held_out))
    recordings, holdout = in_torque(recordings, holdout, terminal)
    recordings, holdout = in_time(recordings, holdout, arguments.align, terminal)
    with terminal.progress(f"adding {arguments.effect}") as progress:
        limits = {"fixed": arguments.fixed, "bounds": arguments.bounds}
        added = add(model, arguments.effect, recordings, holdout, progress, **limits)
    before, after = added.before, added.after
    terminal.heading("Errors, the model refitted without and with the effect")
    terminal.table(*errors_table((before, after)))
    terminal.say(added.text)
    if (shape := added.looks_like) is not None:
        terminal.say(shape)
    if added.left > FAR_ABOVE:
        terminal.say(
            f"what is left is {added.left:.1f} times the noise floor: something else is missing, `diagnose` ranks what"
        )
    if added.doubt is not None:
        terminal.say(f"warning: {added.doubt}", style="yellow")
    terminal.heading("Parameters")
    terminal.table(*parameters_table(after.model))
    wrote([write_model(after.model, arguments.output, asked.fitted, terminal)], terminal)


def _effect(text: str) -> str:
    known_effect(text.partition("@")[0], addition)
    return text
