"""Input that once ended a command in a traceback, a hang, gigabytes or a wrong result: now one line and exit 2."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pendulum_env.plant import paper_plant
from pendulum_env.recording import Recording, write_recording
from workbench.cli import main
from workbench.mistakes import LONGEST, InputError, sentence

MODEL = paper_plant().json()
DIAGNOSIS: dict[str, Any] = {"schema": "pendulum-ident/diagnosis@1", "suggestion": None}
SUGGESTION: dict[str, Any] = {
    "reach": [-1.0, 1.5],
    "seconds": 20.0,
    "peak_torque": 3.0,
    "peak_speed": 9.0,
    "settles": [{"effect": "spring", "instead": None}],
    "signal": {"kind": "two_tone", "amplitude": 3.0, "phases": [0.1, 2.0]},
}


def theta(**entries: object) -> str:
    return json.dumps({**MODEL, "theta": {**MODEL["theta"], **entries}})


def suggested(**changes: object) -> str:
    return json.dumps({**DIAGNOSIS, "suggestion": {**SUGGESTION, **changes}})


def signal(**changes: object) -> str:
    return suggested(signal={**SUGGESTION["signal"], **changes})


MODELS = [
    (theta(inertia={"value": True}), "'theta.inertia.value' of the model is True: it has to be a finite number"),
    (json.dumps({**MODEL, "terms": ["inertia"] * 10_000}), "is a list of 10000: at most 100 are read"),
    (json.dumps({**MODEL, "terms": ["\x1b[31m"]}), "unknown effect '\\x1b[31m'"),
]
DIAGNOSES = [
    ("{", "is not JSON; a diagnosis is what"),
    (json.dumps(MODEL), "is not a diagnosis"),
    (json.dumps(DIAGNOSIS), "leaves nothing open that an experiment would settle"),
    (json.dumps({**DIAGNOSIS, "inseparable": [["torque_offset", "spring"]]}), "no torque tells torque_offset"),
    (json.dumps({**DIAGNOSIS, "forbidden": "no experiment within 0.5 N m"}), "no experiment within 0.5 N m"),
    (json.dumps({**DIAGNOSIS, "inseparable": [[3]]}), "'inseparable[0][0]' of the diagnosis is 3"),
    (suggested(reach=[1.0]), "'suggestion.reach' of the diagnosis is [1.0]: it has to be a list of two angles"),
    (suggested(seconds=1e308), "'suggestion.seconds' of the diagnosis is 1e+308: it has to be a number above 0"),
    (suggested(settles=[{}]), "lacks 'effect' under 'suggestion.settles[0]'"),
    (signal(phases=[1.0] * 3), "a signal is one of two_tone"),
    (signal(kind="levels", edges=[1.0], levels=[4.0]), "within its amplitude"),
]
RIGS = [
    (f'adapter = "serial"\n[serial]\nport = "{"a" * 2000}"', "it has to be a text of up to 1000 characters"),
    (f"{'a' * 100_000} = 1", "unknown key 'aaa"),
]
TRAININGS = [
    ("hidden = 1_000_000_000", "'hidden' is 1000000000: it has to be a whole number from 1 to 4096"),
    ("pendulums = 100_000\nrollout = 1000", "pendulums times rollout is 100000000, at most 50000000 decisions"),
    ("levels = [[1.0], 2.0]", "'levels[0]' is [1.0]: it has to be a finite number"),
]
OPTIONS = [
    (["evaluate", "--plants", "9" * 5000], "should be a whole number from 2 to 10000"),
    (["record", "--amplitude", "nan", "-o", "x.csv"], "'nan' should be a number"),
    (["record", "--counts", "9" * 400, "-o", "x.csv"], "should be a whole number from 0 to 4294967296"),
    (["record", "--theta", "inertia=1e308", "-o", "x.csv"], "inertia of a plant cannot be 1e+308"),
    (["record", "--effect", "stribeck=1e308", "-o", "x.csv"], "stribeck of stribeck cannot be 1e+308"),
    (["record", "--effect", "x" * 100_000, "-o", "x.csv"], "unknown effect 'xxx"),
    (["identify", "run.csv", "--bound", "inertia=1e308:"], "'1e308' should be a number from -1e+09 to 1e+09"),
    (["identify", "run.csv", "--fix", "gravity=nan"], "'nan' should be a number from -1e+09 to 1e+09"),
]
PLAYED = ["record", "--excitation", "suggested", "--diagnosis", "d.json", "-o", "x.csv"]
FILES = [
    *((["compare", "model.json", "run.csv"], "model.json", *case) for case in MODELS),
    *((PLAYED, "d.json", *case) for case in DIAGNOSES),
    *((["record", "--backend", "dm1015b", "--config", "rig.toml", "-o", "x.csv"], "rig.toml", *case) for case in RIGS),
    *((["train", "--config", "config.toml", "-o", "x.npz"], "config.toml", *case) for case in TRAININGS),
]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The folder in which commands run."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(("argv", "name", "content", "reason"), FILES, ids=range(len(FILES)))
def test_a_document_that_cannot_be_is_refused_with_file_and_key(refused, argv, name, content, reason):
    if argv[0] == "train":
        pytest.importorskip("torch")
    Path(name).write_text(content)
    error = refused(*argv)
    assert name in error and reason in error


@pytest.mark.parametrize(("argv", "reason"), OPTIONS, ids=range(len(OPTIONS)))
def test_options_have_upper_ends_that_are_told(refused, argv, reason):
    assert reason in refused(*argv)


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [
        ("torque", 1e308, "torque is 1e+308 at data row 151 (header not counted), of which 1e+09 is the most"),
        ("torque", -1e10, "torque is -1e+10 at data row 151 "),
        ("time", 1e300, "time is"),
        ("velocity", 1e308, "velocity is 1e+308 at data row 151 "),
    ],
)
def test_numbers_that_nothing_measures_are_refused_with_their_row(refused, column, value, reason):
    time = np.arange(300) / 100
    columns = {"time": time, "position": np.sin(3 * time), "torque": 2 + np.cos(time), "velocity": 3 * np.cos(3 * time)}
    columns[column][150] = value
    np.savetxt("run.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    error = refused("identify", "run.csv")
    assert "run.csv" in error and reason in error


def test_time_that_would_become_billions_of_samples_is_refused(refused):
    time = np.concatenate([np.arange(400) * 1e-7, 1.0 + 10.0 * np.arange(50)])
    rows = np.column_stack([time, np.sin(time), np.cos(time)])
    np.savetxt("run.csv", rows, "%.15g", delimiter=",", header="time,position,torque", comments="")
    assert "450 samples would become 4.91e+09 on uniform time" in refused("identify", "run.csv")


@pytest.mark.parametrize(
    "options",
    [
        ["--amplitude", "1e6"],
        ["--noise", "1e6"],
        ["--theta", "gravity=1e9,inertia=1e-9"],
        ["--theta", "viscous=1e9"],
        ["--effect", "quadratic_drag=1e9"],
        ["--effect", "spring=1e9"],
    ],
    ids=" ".join,
)
def test_the_largest_numbers_that_are_taken_give_no_warning(capsys, options):
    assert main(["record", "--seconds", "1.5", *options, "-o", "run.csv"]) in (0, 2)
    assert capsys.readouterr().err.count("\n") <= 1


def test_a_recording_above_the_size_that_is_allowed_is_refused_with_the_option(refused):
    time = np.arange(30_000) / 1000
    write_recording(Recording("run", time, np.sin(3 * time), np.cos(3 * time)), "run.csv")
    Path("study.toml").write_text('[[recording]]\nfile = "run.csv"\n')
    for name in ("run.csv", "study.toml"):
        error = refused("identify", name, "--max-size", "1")
        assert "run.csv" in error and "allow more by --max-size" in error


def test_a_sentence_is_short_and_holds_nothing_that_a_terminal_obeys() -> None:
    told = sentence(InputError(f"a{'b' * 1000}c \x1b[31m\n\td"))
    assert len(told) < LONGEST and told.startswith("ab") and told.endswith("bc \\x1b[31m d") and " ... " in told
    assert sentence(InputError("plain ± text")) == "plain ± text"
