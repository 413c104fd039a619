"""`identify`: estimate the parameters of the paper's model by the six schemes."""

import argparse
from collections.abc import Sequence

from estimators import SCHEMES, Identification, identify, scheme
from estimators.diagnosis.cases import choose_case, find_division
from estimators.schemes.six import PAPER, Scheme
from pendulum_env.notebook import summarise
from pendulum_env.physics import Model
from workbench import options
from workbench.inputs import list_sources, open_sources
from workbench.narrator.identification import explain_trust, list_warnings, tabulate_schemes, write_identification
from workbench.outputs import report_files, write_json, write_model
from workbench.robot import describe_links
from workbench.terminal import Terminal

OVER_WINDOWS = "the least-squares fit over windows, which compare and diagnose use"
SETS: dict[str, tuple[Scheme, ...]] = {"all": SCHEMES, "paper": PAPER}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, schemes and outputs."""
    options.declare(parser, "recordings", *options.READING, "--drive", "--align", *options.LIMITS, "--degrees")
    parser.add_argument(
        "--scheme",
        metavar="all|ID,...",
        type=options.keep_message(_parse_schemes),
        default=SCHEMES,
        help=f"{', '.join(item.id for item in SCHEMES)}; all (default), or paper: all six, set up as in the paper",
    )
    options.add_json(parser, "write estimates, warnings and how the estimates converge")
    parser.add_argument(
        "-o",
        "--output",
        metavar="MODEL.json",
        help="write the fit over windows, which compare and diagnose use, or that of the one scheme given",
    )
    options.add_robot(parser)


def _parse_schemes(text: str) -> Sequence[Scheme]:
    return SETS.get(text) or [scheme(id.strip()) for id in text.split(",")]


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the estimates of the schemes, and warnings on the data."""
    outputs = [arguments.json, arguments.output]
    inputs = open_sources(arguments, list_sources(arguments, outputs), terminal, holdout=arguments.align)
    data = inputs.calibrate(terminal, True if arguments.align else None, arguments.fixed)
    terms, body = inputs.model.terms, inputs.body
    with terminal.progress("identifying"):
        limits = {"fixed": arguments.fixed, "bounds": arguments.bounds}
        identification = identify(data.recordings, terms, arguments.scheme, **limits)
        primary = identification.primary
        is_divided = find_division(terms, data.recordings) is not None
        nearest = None if is_divided else choose_case(terms, data.recordings).find_nearest_links(primary.model)
        model, fit = _choose_model(identification, arguments)
    for text in describe_links(body):
        terminal.print(text)
    nearest_json = nearest.json() if nearest is not None else None
    write_json(arguments.json, write_identification(identification) | {"nearest_body": nearest_json})
    terminal.print_heading("Estimates ± standard errors")
    estimates = tabulate_schemes(identification)
    terminal.print_table(*estimates)
    if text := explain_trust(estimates):
        terminal.print(text)
    for text in list_warnings(identification):
        terminal.print(f"warning: {text}", style="yellow")
    if nearest is not None:
        terminal.print(f"{primary.scheme}: {summarise(nearest)}")
    outputs[1] = None
    try:
        outputs[1] = None if model is None else write_model(model, arguments.output, identification.findings)
    finally:
        report_files(outputs, terminal)
    if outputs[1] is not None and model is not None:
        terminal.print(f"{outputs[1]} has {fit}")


def _choose_model(identification: Identification, arguments: argparse.Namespace) -> tuple[Model | None, str]:
    """Return the model for `-o` and the name of its fit: by one scheme, or over windows."""
    if identification.is_of_scheme:
        return identification.model, f"the estimates of {identification.primary.scheme}"
    return (identification.model if arguments.output is not None else None), OVER_WINDOWS
