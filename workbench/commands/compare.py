"""`compare`: a model against recordings."""

from __future__ import annotations

import argparse

from estimators.comparison import compare, in_units_of
from estimators.in_loop.rollouts import are_driven
from estimators.show.tables import distances_table, profile_table
from workbench.inputs import (
    check_outputs,
    given,
    in_time,
    of_pendulums,
    read_model,
    read_recordings,
    take_align,
    take_recordings,
    take_report,
    take_robot,
    write_json,
    wrote,
)
from workbench.mistakes import InputError
from workbench.terminal import Terminal
from workbench.words import enumerate_words

LAST = ""  # joint of a payload, if none is named
FOLLOWED = 80.0  # [%] of the motion in free runs, below which torque alone does not make a good model


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, recordings and output."""
    parser.add_argument("model", metavar="MODEL.json", help="what identify, diagnose or add wrote with -o")
    take_recordings(parser, what="each compared with the model")
    take_align(parser)
    take_report(parser)
    parser.add_argument(
        "--loop",
        action="store_true",
        help="whole recordings simulated from their goals alone, which needs --drive or a study with [drive]; where a "
        "drive is known, these errors stand beside the others anyway",
    )
    take_robot(parser)
    parser.add_argument(
        "--payload",
        metavar="JOINT",
        nargs="?",
        const=LAST,
        help="with --robot: what the arm carries in these recordings and the model does not know, at the link behind "
        "JOINT (default the last)",
    )
    parser.add_argument(
        "--without",
        metavar="RECORDING",
        action="append",
        default=[],
        help="with --payload: a recording without it (may be repeated), to which the model is fitted anew",
    )
    parser.add_argument("--json", metavar="FILE", help="write errors, profiles and regions")
    of_pendulums(parser, "align", "loop", "drive")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the errors of the model, and where they are."""
    if arguments.robot is not None:
        from workbench import arms  # Pinocchio is imported by who needs it

        arms.compare(arguments, terminal)
        return
    if arguments.payload is not None or arguments.without:
        raise InputError("--payload and --without are for arms: say which with --robot")
    asked = given(arguments)
    outputs = [arguments.json, arguments.report]
    check_outputs(outputs, [arguments.model, *asked.files])
    model = read_model(arguments.model)
    asked = asked.read_as(model.log_format, arguments.model)
    recordings = read_recordings((*asked.fitted, *asked.held_out), terminal)
    if arguments.loop and not are_driven(recordings):
        raise InputError(
            f"{recordings[0].name}: nobody knows its controller: say it with --drive, or [drive] in a study"
        )
    recordings = list(in_units_of(model, recordings))
    if recordings[0].torque_constant is not None:
        terminal.say(recordings[0].torque_constant.text)
    terminal.torque_unit = model.torque_unit
    recordings, _ = in_time(recordings, [], arguments.align, terminal)
    with terminal.progress("comparing"):
        found = compare(model, recordings)
    write_json(arguments.json, found.json())
    if arguments.report is not None:
        from workbench.report.comparison import write_comparison_report  # plotly takes a while to import

        with terminal.progress("writing the report"):
            write_comparison_report(arguments.report, found, recordings)
    terminal.heading(f"Errors of the model with {enumerate_words([term.id for term in model.terms])}")
    terminal.table(*distances_table(found))
    for text in filter(None, (found.told_in_loop, found.caveat)):
        terminal.say(text)
    if found.disagreements:
        terminal.heading("Recordings that disagree")
        for disagreement in found.disagreements:
            terminal.say(f"- {disagreement.text}")
    terminal.heading(f"Where, all {len(recordings)} recordings together" if len(recordings) > 1 else "Where")
    for region in found.regions:
        terminal.say(f"- {region.text}")
    drawn = next((item for r in found.regions for item in found.profiles if item.axis == r.axis != "frequency"), None)
    if drawn is not None:
        terminal.table(*profile_table(drawn))
    if len(found.regions) > 1:
        terminal.say("regions of different quantities may be of the same moments")
    if found.regions:
        terminal.say("`diagnose` tells which effect would explain this")
    elif found.joint.errors.position_fit >= FOLLOWED:
        terminal.say("nothing stands out of the noise: the model explains these recordings")
    else:
        error = f"{found.joint.errors.position_rms:.3g} rad"
        terminal.say(
            f"nothing in torque stands out of the noise, but free runs err by {error}: something acts near turns or at "
            "rest, `diagnose` tells what may"
        )
    wrote(outputs, terminal)
