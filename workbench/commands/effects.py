"""`effects`: the library."""

from __future__ import annotations

import argparse

from pendulum_env.physics import BASE, Term, effects
from pendulum_env.physics.table import TABLES
from pendulum_env.plant import typical
from pendulum_env.words import listing
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Take no arguments."""


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """List the effects with kind, law, parameters and units."""
    rows = [(id, kind.kind, kind.law, parameters(kind)) for id, kind in effects().items()]
    terminal.heading(f"torque = {' + '.join(term.law for term in BASE)} + any of {len(rows)} effects")
    terminal.table(
        ("effect", "kind", "law", "parameters, of typical size"),
        rows,
        left=("kind", "law", "parameters, of typical size"),
    )
    terminal.say(
        f"what no effect is, `add` keeps as a table: {listing([f'{id} {kind.law}' for id, kind in TABLES.items()])}"
    )
    terminal.say(
        "hide one in a simulated recording: record --effect stribeck, --effect stribeck=0.4,0.3 (parameters in this "
        "order), --effect cogging:order=14,sin=0.2 or, with one stop alone, --effect hard_stop:upper=0.9,lower=-inf"
    )


def parameters(kind: type[Term]) -> str:
    """Parameters of an effect as its text form takes them: `stribeck 0.45 N m, stribeck_velocity 0.5 rad/s`."""
    units = [column.unit for column in kind().columns] + [shape.unit for shape in kind.shapes]
    values = typical(kind)
    return ", ".join(
        f"{name} {value:g} {unit}".removesuffix(" 1") for (name, value), unit in zip(values.items(), units, strict=True)
    )
