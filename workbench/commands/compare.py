"""`compare`: a model against recordings."""

import argparse
from collections.abc import Sequence
from dataclasses import replace

from estimators.arms.payload import Payload, find_payload
from estimators.comparison import compare
from estimators.data.calibration import convert_to_model_unit
from estimators.data.fit_data import FitData
from estimators.regression.equations import IdentificationError
from estimators.simulation.free_running import HORIZON
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import find_links
from pendulum_env.formatting import TextTable, join_words
from pendulum_env.recording import NEWTON_METRE, Recording
from pendulum_env.recording.study import apply_log_format
from workbench import options
from workbench.errors import InputError
from workbench.inputs import Inputs, list_sources, open_sources, read_all, read_source_names, report_timing
from workbench.narrator.diagnosis import write_comparison
from workbench.narrator.parts import Part
from workbench.narrator.results import narrate_comparison
from workbench.outputs import check_outputs, report_files, write_json, write_page
from workbench.printing import print_parts
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, recordings and output."""
    options.add_model(parser)
    options.add_recordings(parser)
    options.add_drive(parser)
    options.add_alignment(parser)
    options.add_report(parser)
    options.add_degrees(parser)
    parser.add_argument(
        "--horizon",
        type=options.convert_number(1e-3),
        help=f"simulate free motion over so many seconds (default {HORIZON:g})",
    )
    parser.add_argument(
        "--payload",
        metavar="JOINT",
        nargs="?",
        const="",  # no joint is named
        help="with --robot: identify the load that the arm carries in these recordings, at the link behind JOINT "
        "(default: the last)",
    )
    parser.add_argument(
        "--without",
        metavar="RECORDING",
        action="append",
        default=[],
        help="with --payload: a recording without the load (may be repeated), to which the model is refitted",
    )
    parser.add_argument("--json", metavar="FILE", help="write errors, profiles and regions")
    options.add_robot(parser, arms=["payload", "without"], pendulums=["horizon"])


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the errors of the model, and where they are."""
    if arguments.without and arguments.payload is None:
        raise InputError("--without is of the arm without its payload: say --payload, too")
    outputs = [arguments.json, arguments.report]
    check_outputs(outputs, [arguments.model])
    asked = open_sources(arguments, list_sources(arguments, outputs), terminal)
    model, recordings = asked.model, [*asked.recordings, *asked.holdout]
    if not isinstance(asked.body, Body):
        given = report_timing(FitData(convert_to_model_unit(model, recordings)), arguments.align, terminal)
    else:
        given = asked.calibrate(terminal, arguments.align)
    recordings = [*given.recordings, *given.holdout]
    with terminal.progress("comparing"):
        found = compare(model, recordings, horizon=arguments.horizon)
    payload, is_asked = None, arguments.payload is not None
    if isinstance(asked.body, Body):
        payload = find_carried_load(arguments, asked, recordings, terminal)
    payload_json = payload.json() if payload is not None and is_asked else None
    write_json(arguments.json, write_comparison(found) | {"payload": payload_json})
    write_page(arguments.report, terminal, "workbench.report:render_comparison", found)
    print_parts(narrate_comparison(found), terminal)
    if payload is not None and is_asked:
        print_parts(narrate_payload(payload, find_links(model.terms)), terminal)
    elif payload is not None and payload.stands_out:
        mass = payload.estimates["m"].text
        terminal.say(f"\nA payload of {mass} kg behind {payload.joint} would explain most of it: see --payload")
    report_files(outputs, terminal)


def find_carried_load(
    arguments: argparse.Namespace, asked: Inputs, recordings: Sequence[Recording], terminal: Terminal
) -> Payload | None:
    """Find the payload of an arm in recordings relative to a model; None if it is unknown and was not requested."""
    sources = [source for name in arguments.without for source in read_source_names(name, arguments)]
    sources = [apply_log_format(own, asked.model.log_format, arguments.model) for own in sources]
    empty = replace(asked, recordings=read_all(sources, terminal, asked.read), holdout=[])
    without = empty.calibrate(terminal, arguments.align).recordings if sources else ()
    try:
        return find_payload(asked.model, recordings, without, arguments.payload or None)
    except IdentificationError:
        if arguments.payload is not None:
            raise
        return None


def narrate_payload(found: Payload, body: Body) -> list[Part]:
    """Describe the payload of an arm, and its effect on the errors."""
    rows = [(name, one.text, one.unit) for name, one in found.estimates.items()]
    rows += [(f"centre {axis}", one.text, one.unit) for axis, one in found.center.items()]
    content: list[TextTable | str] = [TextTable(("parameter", "estimate", "unit"), rows, left=("unit",))]
    if found.hidden:
        content.append(f"{join_words(found.hidden)}: no motion of the joints shows them")
    if found.exists is False:
        content.append(
            "No body has the moments of the best fit, so those of the nearest body are shown: something else changed "
            "as well, or the motion says too little."
        )
    left = [
        (at, f"{old:.4g}", f"{new:.4g}", body.units(at).unit(NEWTON_METRE)) for at, (old, new) in found.left.items()
    ]
    explained = TextTable(("joint", "without payload", "with it", "unit"), left, left=("unit",))
    return [
        Part(f"Payload at the link behind {found.joint}, in that joint's frame", content),
        Part("Torque errors, friction refitted", [explained]),
    ]
