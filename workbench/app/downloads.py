"""Files to download, and the command lines equivalent to a session."""

import shlex
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from estimators.schemes.result import SAVED_SCHEME
from pendulum_env.files import format_json
from pendulum_env.lookup import find
from pendulum_env.recording.study import collect_log_format, write_study
from workbench.app.demo import FOLDER as DEMO
from workbench.app.state import State, list_added
from workbench.app.uploads import MODEL, STUDY
from workbench.errors import InputError
from workbench.narrator.diagnosis import write_diagnosis
from workbench.report import render

PROGRAM = "pendulum-ident"
REPORT, DIAGNOSIS, EXPERIMENT = "report.html", "diagnosis.json", "experiment.csv"


def write_commands(state: State) -> str:
    """Write the command lines that make the model of a state."""
    files = [(item.held_out, item.source.file) for item in state.loaded]
    train, holdout = ([str(f) if f.parent == DEMO else f.name for is_held, f in files if is_held == k] for k in (0, 1))
    recordings = [*train, *(word for file in holdout for word in ("--holdout", file))]
    if is_study_needed(state):
        train = recordings = [STUDY]  # the study names the held-out recordings
    limits, align = state.choices.write_options("fix", "bound"), ["--align"] * state.is_aligned
    lines, model, scheme = list[list[str]](), state.model_file, list[str]()
    if (robot := state.robot) is not None:
        of_robot = ["--robot", robot.file.name, *["--rotors"] * bool(robot.rotors)]
        train = recordings = [*recordings, *of_robot, *["--no-gravity"] * robot.weightless]
        scheme = ["--scheme", SAVED_SCHEME]
    if model:
        lines.append(["compare", model, *train, *align])
    else:
        lines.append(["identify", *train, *scheme, *align, *limits, "-o", MODEL])
    before = len([effect for effect in state.added if effect in list_added(state.steps_before)])
    # added effects in order; an empty text is the diagnosis
    for effect in (*state.added[:before], *[""] * (state.diagnosis is not None), *state.added[before:]):
        if effect:
            lines.append(["add", model or MODEL, effect, *recordings, *align, *limits, "-o", MODEL])
            model = MODEL
        else:
            search = [*(["--model", model] if model else []), *state.choices.write_options("only", "without"), *limits]
            lines.append(["diagnose", *recordings, *search, "--report", REPORT, "--json", DIAGNOSIS])
    return "\n".join(shlex.join([PROGRAM, *words]) for words in lines)


def is_study_needed(state: State) -> bool:
    """Return whether the command lines need a study file: for columns, ranges, loads or joints."""
    sources = [item.source for item in state.loaded]
    return state.robot is not None or any(
        source.columns or source.unwrap or source.range or source.load for source in sources
    )


def write_study_text(state: State) -> str:
    """Write a study of the recordings with their settings, for the folder of the recordings."""
    with tempfile.TemporaryDirectory() as folder:
        file, joints = Path(folder) / STUDY, state.robot.joints if state.robot is not None else None
        sources = [replace(item.source, joints=joints) for item in state.loaded]
        write_study([replace(source, file=file.with_name(source.file.name)) for source in sources], file)
        return file.read_text(encoding="utf-8")


def _write_model(state: State) -> str:
    fitted = [item.recording for item in state.loaded if not item.held_out]
    return format_json(replace(state.model, log_format=collect_log_format(fitted)).json())


def _write_experiment(state: State) -> str:
    if state.diagnosis is None or state.diagnosis.suggestion is None or state.diagnosis.suggestion.signal is None:
        raise InputError("the diagnosis suggests no experiment")
    return state.diagnosis.suggestion.csv()


FILES: dict[str, tuple[str, Callable[[State], str]]] = {  # file name and content of each download
    "report": (REPORT, lambda state: render(state.result, write_commands(state))),
    "model": (MODEL, _write_model),
    "diagnosis": (DIAGNOSIS, lambda state: format_json(write_diagnosis(state.result))),
    "experiment": (EXPERIMENT, _write_experiment),
    "study": (STUDY, write_study_text),
}


def make_file(state: State, key: str) -> tuple[str, bytes]:
    """Return the name and content of a download in `FILES`."""
    name, content = find("file", key, FILES)
    return name, content(state).encode()
