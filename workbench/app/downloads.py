"""Files that the page saves."""

import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pendulum_env.lookup import find
from pendulum_env.recording.study import collect_log_format, write_study
from workbench.app.equivalent import DIAGNOSIS, REPORT, write_commands
from workbench.app.state import State
from workbench.app.uploads import MODEL, STUDY
from workbench.errors import InputError
from workbench.narrator.diagnosis import write_diagnosis
from workbench.report import render

EXPERIMENT = "experiment.csv"


def write_study_text(state: State) -> str:
    """Write a study that names the recordings as they are read, for a folder that holds them."""
    with tempfile.TemporaryDirectory() as folder:
        file, joints = Path(folder) / STUDY, state.robot.joints if state.robot is not None else None
        sources = [replace(one.source, joints=joints) for one in state.loaded]
        write_study([replace(source, file=file.with_name(source.file.name)) for source in sources], file)
        return file.read_text(encoding="utf-8")


def _format_json(content: Any) -> str:
    return json.dumps(content, indent=1) + "\n"


def _write_model(state: State) -> str:
    fitted = [one.recording for one in state.loaded if not one.held_out]
    return _format_json(replace(state.model, log_format=collect_log_format(fitted)).json())


def _write_experiment(state: State) -> str:
    if state.diagnosis is None or state.diagnosis.suggestion is None or state.diagnosis.suggestion.signal is None:
        raise InputError("the diagnosis suggests no experiment")
    return state.diagnosis.suggestion.csv()


FILES: dict[str, tuple[str, Callable[[State], str]]] = {  # name and content of what any stage saves
    "report": (REPORT, lambda state: render(state.result, write_commands(state))),
    "model": (MODEL, _write_model),
    "diagnosis": (DIAGNOSIS, lambda state: _format_json(write_diagnosis(state.result))),
    "experiment": (EXPERIMENT, _write_experiment),
    "study": (STUDY, write_study_text),
}


def make_file(state: State, what: str) -> tuple[str, bytes]:
    """Name and content of one of `FILES`."""
    name, content = find("file", what, FILES)
    return name, content(state).encode()
