"""`compare`: a model against recordings."""

import argparse

from estimators.comparison import compare, in_units_of
from estimators.in_loop.rollouts import are_driven
from estimators.show.story import of_comparison
from pendulum_env.arms.joints import links_of
from pendulum_env.files import write_whole
from workbench.arms import carried, of_payload
from workbench.inputs import check_outputs, write_json, wrote
from workbench.mistakes import InputError
from workbench.opened import opened, tell_preprocessed
from workbench.options import KINDS, READING, ROBOT, declare, take_robot
from workbench.story import tell
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, recordings and output."""
    declare(
        parser,
        f"""
        model
        recordings  {KINDS}; each compared with the model
        {READING} --drive --align --report
        --loop  simulate whole recordings in closed loop from their reference, which needs --drive or a study with
            [drive]; if a drive is known, these errors are given anyway
        {ROBOT}
        --payload JOINT  with --robot: identify the load that the arm carries in these recordings, at the link behind
            JOINT (default: the last)
        --without RECORDING  with --payload: a recording without the load (may be repeated), to which the model is
            refitted
        --json FILE  write errors, profiles and regions
        """,
        payload={"nargs": "?", "const": ""},  # no joint is named
        without={"action": "append", "default": []},
    )
    take_robot(parser, arms=("payload", "without"), pendulums=("align", "loop", "drive"))


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the errors of the model, and where they are."""
    if arguments.without and arguments.payload is None:
        raise InputError("--without is of the arm without its payload: say --payload, too")
    outputs = [arguments.json, arguments.report]
    check_outputs(outputs, [arguments.model])
    asked = opened(arguments, outputs, terminal)
    model, recordings = asked.model, [*asked.recordings, *asked.holdout]
    if arguments.loop and not are_driven(recordings):
        raise InputError(
            f"{recordings[0].name}: nobody knows its controller: say it with --drive, or [drive] in a study"
        )
    if asked.body is None:
        given = tell_preprocessed(in_units_of(model, recordings), arguments.align, terminal)
        recordings = list(given.recordings)
    with terminal.progress("comparing"):
        found = compare(model, recordings)
    payload, is_asked = None, arguments.payload is not None
    if asked.body is not None:
        payload = carried(arguments, asked, recordings, terminal)
    write_json(arguments.json, found.json() | ({"payload": payload.json()} if payload is not None and is_asked else {}))
    if arguments.report is not None:
        from workbench.report import render_comparison  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_whole(arguments.report, render_comparison(found))
    tell(of_comparison(found), terminal)
    if payload is not None and is_asked:
        tell(of_payload(payload, links_of(model.terms)), terminal)
    elif payload is not None and payload.stands_out:
        mass = payload.estimates["m"].text
        terminal.say(f"\nA payload of {mass} kg behind {payload.joint} would explain most of it: see --payload")
    wrote(outputs, terminal)
