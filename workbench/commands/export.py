"""`export`: write a model for MuJoCo, as Python or C, as text for other programs, or as a feedforward."""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import fields, replace

from estimators.data.calibration import convert_to_model_unit
from pendulum_env.files import write_whole
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from pendulum_env.recording.study import Source, apply_log_format
from pendulum_env.robot_file import RobotOptions
from workbench import options
from workbench.errors import InputError
from workbench.export import FORMATS, Exported, Request, export
from workbench.inputs import make_body, read_all, read_model, read_source_names
from workbench.outputs import check_outputs, report_files
from workbench.robot import make_robot
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare model, format, output and options of the format."""
    options.declare(parser, "model")
    parser.add_argument(
        "--to", required=True, choices=tuple(FORMATS), help="; ".join(f"{id}, {about}" for id, about in FORMATS.items())
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="write it there (default: print it, unless --check)")
    parser.add_argument(
        "--approximate",
        action="store_true",
        help="approximate or leave out what the format cannot hold, and say so in the file",
    )
    parser.add_argument(
        "--step",
        type=options.convert_number(1e-6, 0.1),
        default=Request.step,
        help=f"of python, c and mjcf [s] (default {Request.step:g})",
    )
    parser.add_argument(
        "--language", choices=("c", "python"), default=Request.language, help="of feedforward (default c)"
    )
    options.declare(
        parser,
        "--drive",
        help=f"the controller exported with the joint, {options.describe_drives()}; the input is then a goal, not a "
        "torque",
    )
    group = parser.add_argument_group("mjcf, --armature also for snippet, --check also for feedforward")
    group.add_argument(
        "--mass",
        metavar="KG",
        type=options.convert_number(1e-6),
        help="of the arm, where it is known: motion tells inertia and weight, not mass (default: a uniform rod)",
    )
    group.add_argument(
        "--armature",
        metavar="KGM2",
        type=options.convert_number(0.0),
        default=0.0,
        help="inertia of the rotor about the joint, where it is known: motion tells its sum with the arm's (default 0)",
    )
    group.add_argument(
        "--check",
        metavar="RECORDING",
        help="run it in MuJoCo against a recording or a study, with --drive from its goals; a feedforward: the torque "
        "that it leaves",
    )
    options.declare(parser, *options.READING)
    options.add_robot(parser, pendulums=["mass", "armature"], about="the arm of the model")


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """Export the model, check it if requested, and print the parts that the format lacks."""
    sources = _find_checks(arguments)
    files = [arguments.model, *filter(None, [arguments.robot]), *(str(source.file) for source in sources)]
    check_outputs([arguments.output], files)
    for option, formats in {
        "check": ["mjcf", "feedforward"],
        "mass": ["mjcf"],
        "armature": ["mjcf", "snippet"],
    }.items():
        if getattr(arguments, option) and arguments.to not in formats:
            raise InputError(f"--{option} goes with {' or '.join(formats)}, not with {arguments.to}")
    saved = RobotOptions.read_from_model(arguments.model if arguments.robot else None)
    model = read_model(arguments.model, make_body(arguments))
    request = Request(**{field.name: getattr(arguments, field.name) for field in fields(Request)})
    if request.drive is not None:
        request = replace(request, drive=request.drive.complete_conventions(model.log_format))
    model.refuse_unknown_inertia()
    exported = export(model, arguments.to, request)
    if sources:
        sources = tuple(apply_log_format(source, model.log_format, arguments.model) for source in sources)
        read = Source.read if arguments.robot is None else make_robot(arguments, sources, saved).read
        recordings = tuple(recording for _, recording in read_all(sources, terminal, read))
        if model.mechanism.can_simulate:
            recordings = convert_to_model_unit(model, recordings)
        _check(model, exported, request, recordings, terminal, arguments.to)
    if arguments.output is not None:
        write_whole(arguments.output, exported.content)
        for note in exported.notes:
            terminal.print(f"{note}", style="yellow")
    elif not sources:
        sys.stdout.write(exported.content)
    report_files([arguments.output], terminal)


def _find_checks(arguments: argparse.Namespace) -> tuple[Source, ...]:
    """Return the recordings of the check; for a study, its held-out ones, or all without any."""
    if arguments.check is None:
        return ()
    settings = vars(arguments)
    if arguments.check.lower().endswith(".toml"):
        settings = settings | {"drive": None}  # --drive belongs to the export; a study has its own drives
    sources = read_source_names(arguments.check, argparse.Namespace(**settings))
    return tuple(source for source in sources if source.role == "holdout") or sources


def _check(
    model: Model,
    exported: Exported,
    request: Request,
    recordings: tuple[Recording, ...],
    terminal: Terminal,
    format: str,
) -> None:
    """Print the deviation of the exported model from recordings, also relative to the recordings."""
    from workbench.export.check import check, check_feedforward  # slow to import

    is_torque = format == "feedforward"
    with terminal.progress("comparing" if is_torque else "running in MuJoCo"):
        result = check_feedforward(model, recordings) if is_torque else check(model, exported, request, recordings)
    terminal.print_heading(result.title)
    motions = result.motion if isinstance(result.motion, Mapping) else dict.fromkeys(result.errors, result.motion)
    shares = [100 * error / motions[name] for name, error in result.errors.items()]
    rows = [
        (name, f"{error:.3g} {result.unit}", f"{share:.0f} %" if share > 99 else f"{share:.2g} %")
        for (name, error), share in zip(result.errors.items(), shares, strict=True)
    ]
    terminal.print_table(("", "error", result.of), rows)
