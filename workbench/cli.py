"""Command line: `pendulum-ident COMMAND ...`; exit 0 on success, 2 on bad input with one line on stderr."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from pendulum_env.lookup import find
from workbench.commands import COMMANDS
from workbench.inputs import MISTAKES, InputError, sentence
from workbench.terminal import Terminal

SUCCESS, BAD_INPUT, INTERRUPTED = 0, 2, 130
PROGRAM = "pendulum-ident"
DESCRIPTION = "Compare a pendulum's model with measurements, see where it fails, and find the effect that is missing."


class Parser(argparse.ArgumentParser):
    """Parser whose complaints are one line."""

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage and leaving."""
        raise InputError(f"{message} (see {self.prog} --help)")


def parser() -> Parser:
    """Parser of all commands."""
    program = Parser(prog=PROGRAM, description=DESCRIPTION)
    commands = program.add_subparsers(metavar="COMMAND", required=True)
    for name, command in COMMANDS.items():
        sub = commands.add_parser(name, help=command.summary, description=command.summary.capitalize() + ".")
        command.configure(sub)
        sub.set_defaults(run=command.run)
    return program


def parse(argv: Sequence[str]) -> argparse.Namespace:
    """Arguments of a command.

    Raises:
        InputError: if they make no sense.
    """
    if argv and not argv[0].startswith("-"):
        try:
            find("command", argv[0], COMMANDS)
        except ValueError as error:
            raise InputError(str(error)) from None
    return parser().parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    try:
        arguments = parse(sys.argv[1:] if argv is None else argv)
        arguments.run(arguments, Terminal())
        sys.stdout.flush()
    except SystemExit as done:  # argparse leaves so after --help
        return SUCCESS if done.code is None else int(done.code)
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return SUCCESS
    except MISTAKES as mistake:
        return _complain(sentence(mistake), BAD_INPUT)
    return SUCCESS


def _complain(message: str, code: int) -> int:
    print(f"{PROGRAM}: {message}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
