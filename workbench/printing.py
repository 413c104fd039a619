"""Printed form of a diagnosis: a short summary, and tables with `--verbose`."""

from collections.abc import Sequence

from estimators.diagnosis.result import Diagnosis
from pendulum_env.formatting import TextTable
from workbench.narrator.parts import Part, list_texts
from workbench.narrator.results import REMARKS, narrate_diagnosis, narrate_summary
from workbench.terminal import Terminal

MORE = "more: -v lists candidates and all that was found, --report FILE.html draws it"


def print_parts(parts: Sequence[Part], terminal: Terminal, color: str = "default") -> None:
    """Print the parts of a result, with the titles in a colour."""
    for part in parts:
        terminal.print_heading(part.title, color)
        for item in list_texts(part.content):
            if isinstance(item, TextTable):
                terminal.print_table(*item)
            else:
                terminal.print(item, style="yellow" if item.startswith("warning: ") else None)


def print_diagnosis(diagnosis: Diagnosis, terminal: Terminal, verbose: bool = False, hint: str = MORE) -> None:
    """Print the summary of a diagnosis; with `verbose`, tables and all remarks follow, else the line `hint`."""
    color = "red" if diagnosis.unexplained else "yellow" if diagnosis.selected else "green"
    print_parts([narrate_summary(diagnosis, None if verbose else REMARKS)], terminal, color)
    if verbose:
        print_parts(narrate_diagnosis(diagnosis), terminal)
    elif hint:
        terminal.print(hint)
