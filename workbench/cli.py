"""Command line: `pendulum-ident COMMAND ...`; exit 0 on success, 2 on bad input with one line on stderr."""

import argparse
import difflib
import errno
import shlex
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NoReturn

from pendulum_env.lookup import find
from pendulum_env.settings import use_writer
from pendulum_env.units import show_angles
from workbench.errors import USER_ERRORS, InputError, format_mistake, write_option
from workbench.terminal import STANDARD_OUTPUT, Terminal, abandon

SUCCESS, BAD_INPUT, INTERRUPTED = 0, 2, 130
PROGRAM = "pendulum-ident"
PLUGINS = "pendulum_env.physics.plugin"  # imported on demand, so that --help starts quickly
DESCRIPTION = "Compare a pendulum's model with measurements, see where it fails, and find the effect that is missing."
COMMANDS: dict[str, str] = {  # help text of each command, in the order of first use
    "demo": "hide an effect, record, diagnose and report: the whole workflow in one go",
    "record": "record a pendulum: the rig, or a simulated pendulum or arm, perhaps with hidden effects",
    "identify": "estimate the four parameters of the paper's model by its six schemes",
    "compare": "compare a model with recordings: how far off it is, and where",
    "diagnose": "find the effects that a model lacks, and add them",
    "survey": "diagnose every recording in a folder: one table, and the parameters that drift or jump",
    "add": "add one effect to a model, refit it, and compare the errors",
    "export": "write a model for MuJoCo, or as Python or C",
    "effects": "list the effects that a model may lack, with their laws and parameters",
    "hardware": "check a rig, step by step",
    "emulate": "emulate a rig behind a real protocol, perhaps with hidden effects",
    "train": "train a policy that chooses excitations (needs the extra rl)",
    "evaluate": "compare excitation policies with the paper's signal, on fresh plants",
    "app": "the workbench in a browser: load, compare, diagnose, add, export (needs the extra app)",
}


class Parser(argparse.ArgumentParser):
    """Argument parser with one-line errors and without abbreviated options."""

    def __init__(self, **options: Any) -> None:
        """Accept the options of `argparse.ArgumentParser`."""
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Raise InputError instead of printing the usage and exiting."""
        raise InputError(f"{message} (see {self.prog} --help)")


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Parse the arguments of a command.

    Raises InputError if they are invalid, and PluginError if a file of effects cannot be used.
    """
    named = argv[0] if argv and not argv[0].startswith("-") else None
    if named is not None:
        find("command", named, COMMANDS)
    plugin_parser = Parser(add_help=False)  # load effects before arguments that name them are parsed
    plugin_parser.add_argument("--plugin", action="append", default=[])
    for path in plugin_parser.parse_known_args(argv)[0].plugin:
        import_module(PLUGINS).load_plugin(path)
    program = Parser(prog=PROGRAM, description=DESCRIPTION)
    program.add_argument("--version", action="version", version=f"{PROGRAM} {find_version()}")
    commands = program.add_subparsers(metavar="COMMAND", required=True)
    for name, summary in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=f"{summary[0].upper()}{summary[1:]}.")
        if name == named:  # import only the command that runs
            command = import_module(f"workbench.commands.{name}")
            command.configure(sub)
            sub.add_argument(
                "--plugin", metavar="FILE.py", action="append", help="know the effects that this file registers, too"
            )
            sub.set_defaults(command=name, run=command.run)
    arguments, unknown = program.parse_known_args(argv)
    arguments.line = shlex.join([PROGRAM, *argv])  # the whole command line
    if unknown:
        parser = commands.choices.get(named or "", program)
        option = next((word for word in unknown if word.startswith("-")), "").partition("=")[0]
        near = difflib.get_close_matches(option, parser._option_string_actions, n=1, cutoff=0.75)
        hint = f": did you mean {near[0]}?" if near else ""
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
    _refuse_other_kind(arguments)
    return arguments


def _refuse_other_kind(arguments: argparse.Namespace) -> None:
    """Raise InputError for options of arms without --robot, and options of pendulums with --robot."""
    options = vars(arguments)
    kind, reason = ("of_arms", "is of an arm: give its links with --robot ARM.urdf")
    if options.get("robot") is not None:
        kind, reason = ("of_pendulums", "is for pendulums: leave it out with --robot")
    for name in options.get(kind, ()):
        if options.get(name) not in (None, False, [], {}):
            raise InputError(f"{write_option(name, True)} {reason}")


def find_version() -> str:
    """Return the installed version of this project."""
    try:
        return version(PROGRAM)
    except PackageNotFoundError:
        return "(not installed)"


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    previous = use_writer(write_option)
    try:
        _run(sys.argv[1:] if argv is None else argv)
        print(end="", flush=True)
        return SUCCESS
    except KeyboardInterrupt as interrupt:
        return _print_error(f"interrupted; {interrupt}" if str(interrupt) else "interrupted", INTERRUPTED)
    except BrokenPipeError:  # for example `| head`
        abandon(sys.stdout)
        return SUCCESS
    except USER_ERRORS as mistake:
        if isinstance(mistake, OSError) and mistake.errno == errno.ENOSPC and mistake.filename is None:
            mistake.filename = "standard output"  # errors on files have a name
        return _print_error(format_mistake(mistake), BAD_INPUT)
    except BaseException as error:
        if isinstance(error, SystemExit) and isinstance(error.code, int) and error.code > 128:
            return error.code  # SIGTERM or SIGHUP: see `entry.py`
        if (of_plugin := _find_effect_fault(error)) is None:
            raise
        return _print_error(format_mistake(of_plugin), BAD_INPUT)
    finally:
        use_writer(previous)


def _run(argv: Sequence[str]) -> None:
    try:
        arguments = parse(argv)
    except SystemExit as done:
        if not done.code and _find_effect_fault(done) is None:  # --help or --version
            return
        raise
    with show_angles("deg" if getattr(arguments, "degrees", False) else "rad"):
        has_output = getattr(arguments, "json", None) != STANDARD_OUTPUT  # standard output has the JSON alone
        arguments.run(arguments, Terminal(has_output=has_output))


def _find_effect_fault(error: BaseException) -> Exception | None:
    """Return the error in a user's effect that caused an exception; None for other causes."""
    module = sys.modules.get(PLUGINS)
    return None if module is None else module.describe_fault(error)


def _print_error(message: str, code: int) -> int:
    """Print an error message on stderr, if it is open, and return the exit code."""
    try:
        print(end="", flush=True)
    except (OSError, ValueError):  # disk full, or stream closed
        abandon(sys.stdout)
    try:
        print(f"{PROGRAM}: {message}", file=sys.stderr, flush=True)
    except (OSError, ValueError):
        abandon(sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
