"""Command lines that come to the same as a session."""

import shlex

from estimators.schemes.result import SAVED
from workbench.app.state import State, list_added
from workbench.app.uploads import MODEL, STUDY

PROGRAM = "pendulum-ident"
REPORT, DIAGNOSIS = "report.html", "diagnosis.json"


def write_commands(state: State) -> str:
    """Write the command lines that come to the same model."""
    train, holdout = _list_files(state)
    given = [*train, *(word for file in holdout for word in ("--holdout", file))]
    if is_study_needed(state):
        train = given = [STUDY]  # which says what is held out
    limits, align = state.asked.write_options("fix", "bound"), ["--align"] * state.is_aligned
    lines = [["record", *one.origin, "-o", one.source.file.name] for one in state.loaded if one.origin]
    model, scheme = state.model_file, list[str]()
    if (robot := state.robot) is not None:
        of_robot = ["--robot", robot.file.name, *["--rotors"] * bool(robot.rotors)]
        train = given = [*given, *of_robot, *["--no-gravity"] * robot.weightless]
        scheme = ["--scheme", SAVED]
    if model:
        lines.append(["compare", model, *train, *align])
    else:
        lines.append(["identify", *train, *scheme, *align, *limits, "-o", MODEL])
    for effect in list_moves(state):
        if effect:
            lines.append(["add", model or MODEL, effect, *given, *align, *limits, "-o", MODEL])
            model = MODEL
        else:
            looked = [*(["--model", model] if model else []), *state.asked.write_options("only", "without"), *limits]
            lines.append(["diagnose", *given, *looked, "--report", REPORT, "--json", DIAGNOSIS])
    return "\n".join(shlex.join([PROGRAM, *words]) for words in lines)


def _list_files(state: State) -> tuple[list[str], list[str]]:
    """List the names of files with fitted and held-out recordings."""
    train, holdout = ([s.source.file.name for s in state.loaded if s.held_out == held] for held in (False, True))
    return train, holdout


def list_moves(state: State) -> list[str]:
    """List the steps from the base model: added effects, and an empty text for a diagnosis."""
    before = len([effect for effect in state.added if effect in list_added(state.started)])
    return [*state.added[:before], *[""] * (state.diagnosis is not None), *state.added[before:]]


def is_study_needed(state: State) -> bool:
    """Return whether a study file is needed for columns or joints."""
    sources = [one.source for one in state.loaded]
    return state.robot is not None or any(own.columns or own.unwrap or own.range or own.load for own in sources)
