"""What a command of the command line offers."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

from workbench.terminal import Terminal


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        summary: one line for the help.
        configure: declares its arguments.
        run: does its work with the arguments; raises what `workbench.cli.main` turns into one line.
    """

    summary: str
    configure: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace, Terminal], None]
