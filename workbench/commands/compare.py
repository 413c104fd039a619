"""`compare`: compare a model with recordings."""

import argparse
from collections.abc import Sequence
from dataclasses import replace

from estimators import IdentificationError, compare
from estimators.diagnosis.cases import choose_case
from estimators.diagnosis.links import LinkPayload
from estimators.simulation.free_running import HORIZON
from pendulum_env.recording import Recording
from workbench import options
from workbench.errors import InputError
from workbench.inputs import Inputs, list_sources, open_sources
from workbench.narrator.diagnosis import write_comparison
from workbench.narrator.results import narrate_comparison, narrate_payload
from workbench.outputs import check_outputs, report_files, write_json, write_page
from workbench.printing import print_parts
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, recordings and output."""
    options.declare(parser, "model", "recordings", *options.READING, "--drive", "--align", "--report", "--degrees")
    parser.add_argument(
        "--horizon",
        type=options.convert_number(1e-3),
        help=f"simulate free motion over so many seconds (default {HORIZON:g})",
    )
    parser.add_argument(
        "--payload",
        metavar="JOINT",
        nargs="?",
        const="",  # --payload without a joint
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
    options.add_json(parser, "write errors, profiles and regions")
    options.add_robot(parser, arms=["payload", "without"], pendulums=["horizon"])


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print the errors of the model and the regions of its residual."""
    if arguments.without and arguments.payload is None:
        raise InputError("--without is of the arm without its payload: say --payload, too")
    outputs = [arguments.json, arguments.report]
    check_outputs(outputs, [arguments.model])
    inputs = open_sources(arguments, list_sources(arguments, outputs), terminal)
    data, model = inputs.convert(terminal, arguments.align), inputs.model
    recordings = list(data.all_recordings)
    with terminal.progress("comparing"):
        comparison = compare(model, recordings, horizon=arguments.horizon)
    payload, is_asked = None, arguments.payload is not None
    if not inputs.body.can_simulate:
        payload = find_carried_load(arguments, inputs, recordings, terminal)
    payload_json = payload.json() if payload is not None and is_asked else None
    write_json(arguments.json, write_comparison(comparison) | {"payload": payload_json})
    write_page(arguments.report, terminal, "workbench.report:render_comparison", comparison)
    print_parts(narrate_comparison(comparison), terminal)
    if payload is not None and is_asked:
        print_parts(narrate_payload(payload, model.mechanism), terminal)
    elif payload is not None and payload.is_significant:
        mass = payload.estimates["m"].text
        terminal.print(f"\nA payload of {mass} kg behind {payload.joint} would explain most of it: see --payload")
    report_files(outputs, terminal)


def find_carried_load(
    arguments: argparse.Namespace, inputs: Inputs, recordings: Sequence[Recording], terminal: Terminal
) -> LinkPayload | None:
    """Find the payload of an arm relative to its model; None if it is undetermined and was not requested."""
    empty = replace(inputs, recordings=inputs.read_more(arguments.without, arguments, terminal), holdout=[])
    without = empty.calibrate(terminal, arguments.align).recordings if arguments.without else ()
    try:
        case = choose_case(inputs.model.terms, recordings)
        return case.find_payload(inputs.model, recordings, without, arguments.payload or None)
    except IdentificationError:
        if arguments.payload is not None:
            raise
        return None
