"""Printed form of a diagnosis: a short summary, and tables with `--verbose`."""

from collections.abc import Sequence

from estimators.diagnosis.result import Diagnosis
from pendulum_env.formatting import TextTable
from pendulum_env.physics.estimate import shorten_name
from workbench.narrator.diagnosis import (
    describe_errors,
    describe_next_step,
    describe_refit,
    describe_region,
    describe_result,
    describe_unexplained,
    list_remarks,
)
from workbench.narrator.findings import describe
from workbench.narrator.parts import Part
from workbench.narrator.results import narrate_diagnosis
from workbench.terminal import Terminal

MORE = "more: -v lists candidates and all that was found, --report FILE.html draws it"


def print_parts(parts: Sequence[Part], terminal: Terminal) -> None:
    """Print the parts of a result."""
    for part in parts:
        terminal.heading(part.title)
        for item in part.content:
            if isinstance(item, TextTable):
                terminal.table(*item)
            elif isinstance(item, str):
                terminal.say(item, style="yellow" if item.startswith("warning: ") else None)
            elif isinstance(item, tuple):
                for line in item:
                    terminal.say(f"- {line}")


def print_diagnosis(diagnosis: Diagnosis, terminal: Terminal, verbose: bool = False, more: str = MORE) -> None:
    """Print a diagnosis; for several joints, only the parameters of added effects.

    With `verbose`, tables and all remarks follow; else the line `more`.
    """
    estimates = diagnosis.model.readable
    if len(diagnosis.floors) > 1:
        added = [term.id for term in diagnosis.model.terms if term.id in diagnosis.selected]
        estimates = {name: estimate for id in added for name, estimate in diagnosis.model.get_parameters(id).items()}
    step = describe_next_step(diagnosis)
    lines = [*diagnosis.laws, describe_errors(diagnosis)]
    lines += [describe_refit(diagnosis.refit)] if diagnosis.refit is not None else []
    values = ", ".join(f"{shorten_name(name)} {estimate}" for name, estimate in estimates.items())
    biased = " (biased by the unexplained residual)" if diagnosis.unexplained else ""
    lines += [f"parameters{biased}: {values}"] if values else []
    first = {region.at: region for region in reversed(diagnosis.unexplained)}  # first region of each joint
    lines += [
        f"unexplained: {describe_unexplained(diagnosis, region)}"
        for region in reversed(first.values())
        if describe_region(region) != step
    ]
    lines += [f"{describe(one.finding)} It is not fitted: diagnose it on its own." for one in diagnosis.disagreements]
    lines += [f"note: {remark}" for remark in list_remarks(diagnosis)[: None if verbose else 2]]
    terminal.heading(describe_result(diagnosis))
    for line in (*lines, f"next: {step}"):
        terminal.say(line)
    if verbose:
        print_parts(narrate_diagnosis(diagnosis), terminal)
    elif more:
        terminal.say(more)
