"""`effects`: list the library."""

import argparse

from pendulum_env.formatting import join_words
from pendulum_env.physics import BASE, TABLES, Table, Term, list_nameable
from pendulum_env.physics.effect_texts import find_description, find_look_alikes, name_effect
from pendulum_env.physics.library import find_addition
from pendulum_env.plant import get_typical_values
from workbench.options import keep_message
from workbench.terminal import Terminal


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the effects to describe."""
    parser.add_argument(
        "shown",
        metavar="EFFECT",
        nargs="*",
        type=keep_message(find_addition),
        help="describe how this one shows, and what reveals it",
    )


def run(arguments: argparse.Namespace, terminal: Terminal) -> None:
    """List all effects with kind, law, parameters and units, or describe the given ones."""
    for kind in arguments.shown:
        terminal.print_heading(f"{kind.id}: {kind.law}")
        for line in describe_effect(kind):
            terminal.print(line)
    if arguments.shown:
        return
    rows = [(id, kind.kind, kind.law, list_parameters(kind)) for id, kind in list_nameable().items()]
    terminal.print_heading(f"torque = {' + '.join(term.law for term in BASE)} + any of {len(rows)} effects")
    flush_left = "kind", "law", "parameters, of typical size"
    terminal.print_table(("effect", *flush_left), rows, left=flush_left)
    tables = join_words([f"{id} {kind.law}" for id, kind in TABLES.items()])
    terminal.print(f"`add` keeps a law that is no effect as a table: {tables}")
    terminal.print(
        "to hide one in a simulated recording: record --effect stribeck, --effect stribeck=0.4,0.3 (parameters in this "
        "order), --effect cogging:order=14,sin=0.2 or, with one stop alone, --effect hard_stop:upper=0.9,lower=-inf; "
        "symptoms and look-alikes of an effect: effects stribeck"
    )


def describe_effect(kind: type[Term]) -> list[str]:
    """Return lines on an effect (symptom, similar effects, informative experiment, parameters) or a table."""
    if issubclass(kind, Table):
        return [str(kind.__doc__).partition("\n")[0], "Parameters: coefficients of a spline, by `add`."]
    text = find_description(kind.id)
    look_alikes = [name_effect(id) for id in find_look_alikes(kind.id)]
    similar = f"Confused with {join_words(look_alikes)}." if look_alikes else ""
    values = f"Parameters, of typical size: {list_parameters(kind)}."
    return [line for line in (text.signature, similar, f"What tells: {text.informative_experiment}.", values) if line]


def list_parameters(kind: type[Term]) -> str:
    """List the parameters of an effect in order: `stribeck 0.45 N m, stribeck_velocity 0.5 rad/s`."""
    nonlinear = kind.nonlinear_parameters
    units = [column.unit for column in kind().columns] + [parameter.unit for parameter in nonlinear]
    further = {p.name for p in nonlinear if p.integer and p.nominal is not None}  # repeated columns
    pairs = zip(get_typical_values(kind()).items(), units, strict=True)
    return ", ".join(
        f"{name} {value:g} {unit}".removesuffix(" 1") for (name, value), unit in pairs if name not in further
    )
