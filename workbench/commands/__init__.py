"""The commands in the order of a first visit, each a module of its name.

They are imported one by one: a command does not wait for the libraries of the others.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Protocol, cast

from workbench.terminal import Terminal

COMMANDS: dict[str, str] = {  # and what help says of each
    "demo": "hide an effect, record, diagnose and report: the whole workflow in one go",
    "record": "record a pendulum: the rig, or a simulated one, or arm, with effects hidden in it if asked for",
    "identify": "estimate the four parameters of the paper's model by its six schemes",
    "compare": "compare a model with recordings: how far off it is, and where",
    "diagnose": "find the effects that a model lacks, and add them",
    "survey": "diagnose many recordings and show what the fleet shows: drifts, odd joints (needs the extra fleet)",
    "add": "add one effect to a model, refit it, and compare the errors",
    "export": "write a model for MuJoCo, ROS or Gazebo, as Python or C",
    "effects": "list the effects that a model may lack, with their laws and parameters",
    "paper": "repeat the source paper's experiment: its Table 2 and figures beside ours",
    "hardware": "check a rig, step by step",
    "emulate": "emulate a rig behind a real protocol, with effects hidden in it if asked for",
    "train": "train a policy that chooses excitations (needs the extra rl)",
    "evaluate": "compare excitation policies with the paper's signal, on fresh plants",
    "app": "the workbench in a browser: load, compare, diagnose, add, export (needs the extra app)",
}


class Command(Protocol):
    """What the module of a command offers."""

    def configure(self, parser: argparse.ArgumentParser, /) -> None:
        """Declare the arguments."""

    def run(self, arguments: argparse.Namespace, terminal: Terminal, /) -> None:
        """Do the work; raises what `workbench.cli.main` turns into one line."""


def load(name: str) -> Command:
    """The module of a command."""
    return cast(Command, import_module(f"workbench.commands.{name}"))


__all__ = ["COMMANDS", "Command", "load"]
