"""`identify`: the parameters of the paper's model, by each of the six schemes."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence

import numpy as np

from estimators.equations import IdentificationError
from estimators.evidence import Evidence, fit_terms
from estimators.identify import Identification, identify
from estimators.schemes import PAPER, SCHEMES, Scheme, scheme
from estimators.tables import schemes_table
from pendulum_env.files import write_whole
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.recording import Recording
from workbench.command import Command
from workbench.inputs import InputError, argument, check_outputs, read_recordings, reader, take_recordings, wrote
from workbench.terminal import Terminal

SETS: dict[str, tuple[Scheme, ...]] = {"all": SCHEMES, "paper": PAPER}


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare recordings, schemes and outputs."""
    take_recordings(parser)
    parser.add_argument(
        "--scheme",
        type=argument(_schemes),
        default=SCHEMES,
        metavar="all|ID,...",
        help=f"{', '.join(item.id for item in SCHEMES)}; all (default), or paper: all with the paper's own choices",
    )
    parser.add_argument("--json", metavar="FILE", help="write estimates, warnings and how the estimates converge")
    parser.add_argument("-o", "--output", metavar="MODEL.json", help="write the model, fitted over windows")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the estimates of the schemes side by side, and what the recordings cannot tell."""
    outputs = [arguments.json, arguments.output]
    check_outputs(outputs, arguments.recordings)
    recordings = read_recordings(arguments.recordings, reader(arguments), terminal)
    refuse_slow(recordings, arguments.scheme)
    with terminal.progress("identifying"):
        found = identify(recordings, BASE, arguments.scheme)
        model = fit_terms(Evidence.of(recordings), BASE)[0] if arguments.output is not None else None
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(found.json(), indent=1) + "\n")
    if model is not None:
        model.save(arguments.output)
    tell(found, model, terminal)
    wrote(outputs, terminal)


def six_schemes(recordings: Sequence[Recording], terms: Sequence[Term]) -> Identification | None:
    """Estimates of all schemes with these terms, None where the recordings are too poor for them."""
    try:
        return identify(recordings, terms, SCHEMES)
    except IdentificationError:
        return None


def refuse_slow(recordings: Sequence[Recording], schemes: Sequence[Scheme]) -> None:
    """Refuse recordings that are sampled too slowly for the filter of a scheme, before any work is done."""
    for item in schemes:
        fastest = getattr(item, "cutoff", 0.0) / np.pi  # [Hz], twice the cutoff
        for recording in recordings:
            if recording.rate <= fastest:
                raise InputError(
                    f"{recording.name}: is sampled at {recording.rate:.4g} Hz, {item.id} filters at "
                    f"{np.pi * fastest:g} rad/s and needs more than {fastest:.3g} Hz: choose another --scheme"
                )


def tell(found: Identification, model: Model | None, terminal: Terminal) -> None:
    """Print one row a scheme, and the model that is saved as the last."""
    terminal.heading("Estimates ± standard errors")
    terminal.table(*schemes_table(found, model))
    for doubt in found.doubts:
        terminal.say(f"warning: {doubt.text}", style="yellow")


def _schemes(text: str) -> Sequence[Scheme]:
    return SETS[text] if text in SETS else [scheme(id.strip()) for id in text.split(",")]


COMMAND = Command("estimate the four parameters of the paper's model by its six schemes", configure, run)
