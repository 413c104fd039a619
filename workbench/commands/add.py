"""`add`: one more effect in a model, refit, with the errors before and after."""

from __future__ import annotations

import argparse

from estimators.diagnose import Addition, add
from pendulum_env.physics import effect
from workbench.command import Command
from workbench.inputs import argument, check_outputs, keep_apart, read_model, read_recordings, take_recordings, wrote
from workbench.story import tell_errors, tell_parameters
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
    recordings = read_recordings(arguments.recordings, arguments.unwrap, terminal)
    holdout = read_recordings(arguments.holdout, arguments.unwrap, terminal)
    with terminal.progress(f"adding {arguments.effect}") as progress:
        added = add(model, arguments.effect, recordings, holdout, progress)
    before, after = added.before, added.after
    if arguments.output is not None:
        after.model.save(arguments.output)
    terminal.heading("Errors, the model refitted without and with the effect")
    tell_errors((before, after), terminal)
    terminal.say(judgement(added))
    left = after.errors["holdout"].torque_rms / added.noise_floor
    if left > FAR_ABOVE:
        terminal.say(
            f"what is left is {left:.1f} times the noise floor: something else is missing, `diagnose` ranks what"
        )
    terminal.heading("Parameters")
    tell_parameters(after.model, terminal)
    wrote([arguments.output], terminal)


def judgement(addition: Addition) -> str:
    """Whether the effect earns its place, in a sentence: only data that it was not fitted to can tell."""
    before, after = addition.before, addition.after
    if addition.objection is not None:
        return f"{after.added} {addition.objection}: these recordings give no reason to keep it"
    old, new = before.errors["holdout"], after.errors["holdout"]
    torque, position = new.torque_rms / old.torque_rms, new.position_rms / old.position_rms
    return f"{after.added} lowers the held-out errors: torque to {torque:.1%}, position to {position:.1%} of before"


def _effect(text: str) -> str:
    effect(text)
    return text


COMMAND = Command("add one effect to a model, refit it, and compare the errors", configure, run)
