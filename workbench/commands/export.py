"""`export`: a model in the forms that simulators and programs read."""

from __future__ import annotations

import argparse
import sys

from estimators.comparison import in_units_of
from pendulum_env.files import write_whole
from pendulum_env.physics import Model
from workbench.export import BODIES, FORMATS, READABLE, Exported, Request, export
from workbench.inputs import check_outputs, number, read_model, read_recordings, sources_of, take_reading, wrote
from workbench.mistakes import InputError
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, format, output and how."""
    parser.add_argument("model", metavar="MODEL.json", help="what identify, diagnose or add wrote with -o")
    forms = "; ".join(f"{name}, {what}" for name, (_, what) in FORMATS.items())
    parser.add_argument("--to", required=True, choices=tuple(FORMATS), help=forms)
    parser.add_argument("-o", "--output", metavar="FILE", help="write it there (default: print it, unless --check)")
    parser.add_argument(
        "--approximate",
        action="store_true",
        help="approximate or leave out what the format cannot hold, and say so in the file",
    )
    parser.add_argument(
        "--step",
        type=number(1e-6, 0.1),
        default=Request.step,
        metavar="SECONDS",
        help=f"of python, c and mjcf (default {Request.step:g})",
    )
    parser.add_argument(
        "--mass",
        type=number(1e-6),
        metavar="KG",
        help="of the arm, where it is known: motion tells inertia and weight, not mass (default: a uniform rod)",
    )
    parser.add_argument(
        "--armature",
        type=number(0.0),
        default=0.0,
        metavar="KGM2",
        help="inertia of the rotor about the joint, where it is known: motion tells its sum with the arm's (default 0)",
    )
    parser.add_argument("--check", metavar="RECORDING", help="run it in MuJoCo against a recording: mjcf and urdf")
    take_reading(parser)


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Export, perhaps check, and say what the form does not hold."""
    sources = sources_of(arguments.check, arguments) if arguments.check is not None else ()
    check_outputs([arguments.output], [arguments.model, *(str(source.file) for source in sources)])
    if sources and arguments.to not in READABLE:
        raise InputError(f"--check runs in MuJoCo, which reads {' and '.join(READABLE)}, not {arguments.to}")
    if arguments.to not in BODIES and (arguments.mass or arguments.armature):
        raise InputError(
            f"--mass and --armature are of a rigid body, which {', '.join(BODIES)} have, not {arguments.to}"
        )
    model = read_model(arguments.model)
    exported = export(
        model, arguments.to, Request(arguments.approximate, arguments.step, arguments.mass, arguments.armature)
    )
    if arguments.output is not None:
        write_whole(arguments.output, exported.content)
        for note in exported.notes:
            terminal.say(f"{note}", style="yellow")
    elif not sources:
        sys.stdout.write(exported.content)
    if sources:
        tell(model, exported, arguments, terminal)
    wrote([arguments.output], terminal)


def tell(model: Model, exported: Exported, arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Print how far both simulations are from the recording, and from each other."""
    from workbench.export.check import check  # needs the libraries of a comparison

    recordings = in_units_of(model, read_recordings(sources_of(arguments.check, arguments), terminal))
    with terminal.progress("running in MuJoCo"):
        found = check(model, exported, recordings)
    terminal.heading("Free run over windows of one second, RMS")
    rows = [
        (what, f"{value:.3g} rad", f"{100 * value / found.motion:.2g} %")
        for what, value in (
            ("this project's simulation against the recording", found.own),
            ("MuJoCo with the exported model against the recording", found.mujoco),
            ("one against the other", found.between),
        )
    ]
    terminal.table(("", "error", "of the motion"), rows)
