"""Printed form of a diagnosis: a short summary, and tables with `--verbose`."""

from collections.abc import Sequence

from estimators.diagnosis.result import Diagnosis
from pendulum_env.formatting import TextTable
from pendulum_env.physics.estimate import shorten_name
from workbench.narrator import diagnosis as narration
from workbench.narrator.findings import describe
from workbench.narrator.parts import Part
from workbench.narrator.results import narrate_diagnosis
from workbench.terminal import Terminal

MORE = "more: -v lists candidates and all that was found, --report FILE.html draws it"


def print_parts(parts: Sequence[Part], terminal: Terminal) -> None:
    """Print the parts of a result."""
    for part in parts:
        terminal.print_heading(part.title)
        for item in part.content:
            if isinstance(item, TextTable):
                terminal.print_table(*item)
            elif isinstance(item, str):
                terminal.print(item, style="yellow" if item.startswith("warning: ") else None)
            elif isinstance(item, tuple):
                for line in item:
                    terminal.print(f"- {line}")


def print_diagnosis(diagnosis: Diagnosis, terminal: Terminal, verbose: bool = False, hint: str = MORE) -> None:
    """Print a diagnosis; for several joints, only the parameters of added effects.

    With `verbose`, tables and all remarks follow; else the line `hint`.
    """
    estimates = diagnosis.model.readable
    if len(diagnosis.floors) > 1:
        added = [term.id for term in diagnosis.model.terms if term.id in diagnosis.selected]
        estimates = {name: estimate for id in added for name, estimate in diagnosis.model.get_parameters(id).items()}
    step = narration.describe_next_step(diagnosis)
    lines = [*narration.list_laws(diagnosis), narration.describe_errors(diagnosis)]
    lines += [narration.describe_refit(diagnosis.refit)] if diagnosis.refit is not None else []
    values = ", ".join(f"{shorten_name(name)} {estimate}" for name, estimate in estimates.items())
    biased = " (biased by the unexplained residual)" if diagnosis.unexplained else ""
    lines += [f"parameters{biased}: {values}"] if values else []
    first = {region.at: region for region in reversed(diagnosis.unexplained)}  # first region of each joint
    lines += [
        f"unexplained: {narration.describe_unexplained(diagnosis, region)}"
        for region in reversed(first.values())
        if narration.describe_region(region) != step
    ]
    findings = [disagreement.finding for disagreement in diagnosis.disagreements]
    lines += [f"{describe(finding)} It is not fitted: diagnose it on its own." for finding in findings]
    lines += [f"note: {remark}" for remark in narration.list_remarks(diagnosis)[: None if verbose else 2]]
    terminal.print_heading(narration.describe_result(diagnosis))
    for line in (*lines, f"next: {step}"):
        terminal.print(line)
    if verbose:
        print_parts(narrate_diagnosis(diagnosis), terminal)
    elif hint:
        terminal.print(hint)
