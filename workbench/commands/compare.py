"""`compare`: a model against recordings."""

from __future__ import annotations

import argparse
import json

from estimators.compare import compare
from estimators.tables import distances_table
from pendulum_env.files import write_whole
from workbench.command import Command
from workbench.inputs import check_outputs, read_model, read_recordings, reader, take_recordings, wrote
from workbench.terminal import Terminal
from workbench.words import enumerate_words


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, recordings and output."""
    parser.add_argument("model", metavar="MODEL.json", help="what identify, diagnose or add wrote with -o")
    take_recordings(parser)
    parser.add_argument("--json", metavar="FILE", help="write errors, profiles and regions")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the errors of the model, and where they are."""
    check_outputs([arguments.json], [arguments.model, *arguments.recordings])
    model = read_model(arguments.model)
    recordings = read_recordings(arguments.recordings, reader(arguments), terminal)
    with terminal.progress("comparing"):
        found = compare(model, recordings)
    if arguments.json is not None:
        write_whole(arguments.json, json.dumps(found.json(), indent=1) + "\n")
    terminal.heading(f"Errors of the model with {enumerate_words([term.id for term in model.terms])}")
    terminal.table(*distances_table(found))
    if found.disagreements:
        terminal.heading("Recordings that disagree")
        for disagreement in found.disagreements:
            terminal.say(f"- {disagreement.text}")
    terminal.heading("Where")
    for region in found.regions:
        terminal.say(f"- {region.text}")
    if found.regions:
        terminal.say("`diagnose` tells which effect would explain this")
    else:
        terminal.say("nothing stands out of the noise: the model explains these recordings")
    wrote([arguments.json], terminal)


COMMAND = Command("compare a model with recordings: how far off it is, and where", configure, run)
