"""`identify`: the parameters of the paper's model, by each of the six schemes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from estimators.arguments import within_limits
from estimators.schemes.identification import identify
from estimators.schemes.six import PAPER, SCHEMES, Scheme, scheme
from estimators.show.story import schemes_table
from estimators.weak_form.instruments import fit_by_reference
from pendulum_env.physics import BASE
from workbench.inputs import (
    LIMITS,
    argument,
    of_pendulums,
    opened,
    take,
    take_recordings,
    take_robot,
    write_json,
    write_model,
    wrote,
)
from workbench.terminal import Terminal

SETS: dict[str, tuple[Scheme, ...]] = {"all": SCHEMES, "paper": PAPER}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, schemes and outputs."""
    take_recordings(parser)
    take(parser, "--align")
    take_robot(parser)
    take(parser, *LIMITS, "--instruments")
    parser.add_argument(
        "--scheme",
        type=argument(_schemes),
        default=SCHEMES,
        metavar="all|ID,...",
        help=f"{', '.join(item.id for item in SCHEMES)}; all (default), or paper: all with the paper's own choices",
    )
    parser.add_argument("--json", metavar="FILE", help="write estimates, warnings and how the estimates converge")
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the model, fitted over windows")
    of_pendulums(parser, "align", "instruments", "fixed", "bounds", "drive")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the estimates of the schemes side by side, and what the recordings cannot tell."""
    outputs = [arguments.json, arguments.output]
    asked = opened(arguments, outputs, terminal, holdout=False)
    given = asked.preprocessed(terminal, True if arguments.align else None)  # what is late is a doubt, else
    with terminal.progress("identifying"):
        found = identify(given.recordings, BASE, arguments.scheme, fixed=arguments.fixed, bounds=arguments.bounds)
        model = None
        if arguments.instruments is not None:
            terms, _ = within_limits(BASE, {}, arguments.fixed, arguments.bounds)
            model = found.fitted(lambda data: fit_by_reference(data, terms))
        elif found.data is not None or arguments.output is not None:
            model = found.windows
    write_json(arguments.json, found.json())
    terminal.heading("Estimates ± standard errors")
    terminal.table(*schemes_table(found, model, "instruments" if arguments.instruments else "windows"))
    for doubt in found.doubts:
        terminal.say(f"warning: {doubt.text}", style="yellow")
    if model is not None:
        outputs[1] = write_model(model, arguments.output, asked.fitted, terminal)
    wrote(outputs, terminal)


def _schemes(text: str) -> Sequence[Scheme]:
    return SETS[text] if text in SETS else [scheme(id.strip()) for id in text.split(",")]
