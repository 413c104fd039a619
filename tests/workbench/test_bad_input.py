"""Input that once ended a command in a traceback, a hang, gigabytes or a wrong result: now one line and exit 2."""

import json
import socket
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.diagnosis.result import SCHEMA
from pendulum_env.plant import hide, paper_plant
from workbench.cli import main
from workbench.errors import LONGEST, InputError, format_mistake

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


def suggested(**changes: object) -> str:
    return json.dumps({**DIAGNOSIS, "suggestion": {**SUGGESTION, **changes}})


def signal(**changes: object) -> str:
    return suggested(signal={**SUGGESTION["signal"], **changes})


MODELS = [(json.dumps({**MODEL, "terms": ["\x1b[31m"]}), "unknown effect '\\x1b[31m'")]
DIAGNOSES = [
    ("{", "is not JSON; a diagnosis is what"),
    (json.dumps(MODEL), "is not a diagnosis"),
    (json.dumps(DIAGNOSIS), "suggests no further experiment"),
    (json.dumps({**DIAGNOSIS, "inseparable": [["torque_offset", "spring"]]}), "no torque tells torque_offset"),
    (json.dumps({**DIAGNOSIS, "forbidden": "no experiment within 0.5 N m"}), "no experiment within 0.5 N m"),
    (
        json.dumps({**DIAGNOSIS, "schema": SCHEMA, "no_experiment": {"text": "nothing within 6 A"}}),
        "nothing within 6 A",
    ),
    (suggested(reach=[1.0]), "'suggestion.reach': Expected array of length 2"),
    (suggested(reach=[2, 1]), "'suggestion.reach' is [2, 1]: expected the lower angle first"),
    (suggested(seconds=1e308), "'suggestion.seconds': Expected float <= 100000"),
    (signal(phases=[1.0] * 3), "a signal is one of two_tone"),
    (signal(kind="levels", edges=[1.0], levels=[4.0]), "within its amplitude"),
]
RIGS = [(f"{'a' * 100_000} = 1", "unknown key 'aaa")]
WORDS = [  # with files of `folder`
    ("", "COMMAND"),
    ("diagnos", "unknown command 'diagnos': did you mean diagnose?"),
    ("identify run.csv --scheme hamiltonia", "did you mean hamiltonian?"),
    ("identify run.csv --shceme all", "did you mean --scheme? (see pendulum-ident identify --help)"),
    ("identify run.csv --hold run.csv", "--hold"),
    ("identify run.csv --sche all", "did you mean --scheme? (see pendulum-ident identify --help)"),
    ("record --until diagnosed -o x.csv", "unrecognized arguments: --until diagnosed"),
    ("identify run.csv --columns time", "'time' should be QUANTITY=NAME"),
    ("compare m.json run.csv --columns time=t,time=ms:ms", "time is named twice"),
    ("add spring model.json run.csv", "model.json is a file: the order is MODEL.json EFFECT RECORDING"),
    ("record --excitation chrip -o x.csv", "invalid choice: 'chrip'"),
    ("record --theta coulomb=100 --seconds 1.5 -o x.csv", "the pendulum never moves"),
    ("record --counts 1 --seconds 1.5 -o x.csv", "or turn it by less than one of the 1 --counts"),
    ("record --backend dm1015b -o x.csv", "--backend dm1015b and --config FILE belong together"),
    ("record --backend dm1015b --config rig.toml --effect spring -o x.csv", "--effect does not go with a rig"),
    ("record --backend replay --replay run.csv --rate 500 -o x.csv", "--rate does not go with a replay"),
    ("record --backend gazebo -o x.csv", "invalid choice: 'gazebo'"),
    ("record --seconds 1e5 -o x.csv", "samples are requested"),
    ("record --excitation suggested -o x.csv", "needs --diagnosis FILE"),
    ("record --diagnosis d.json -o x.csv", "goes with --excitation suggested only"),
    ("record --excitation suggested --diagnosis d.json --amplitude 2 -o x.csv", "`diagnose --max-torque` bounds"),
    ("record --backend replay -o x.csv", "--replay FILE belong together"),
    ("diagnose run.csv --fix gravity", "NAME=VALUE"),
    ("diagnose run.csv --fix gravity=1 --fix gravity=2", "gravity is given twice"),
    ("diagnose run.csv --bound viscous=0:1,viscous=0:2", "viscous is given twice"),
    ("diagnose run.csv --bound gravity=1", "NAME=LOW:HIGH"),
    *(
        (
            f"diagnose run.csv --significance {value}",
            f"--significance: '{value}' should be a number from 1e-09 to 0.5",
        )
        for value in ("0", "nan", "5%")
    ),
    ("diagnose run.csv --report report.pdf", "name it"),
    ("effects backlahs", "did you mean backlash?"),
    ("record -o nowhere/run.csv", "there is no folder"),
    ("identify run.csv -o run.csv", "is one of the inputs"),
    ("diagnose run.csv --holdout model.json --json run.csv", "is one of the inputs"),
    ("diagnose run.csv --json x.json -o x.json", "two outputs"),
    ("diagnose run.csv --json empty", "is a folder"),
    ("compare none.json run.csv", "lacks the term inertia"),
    ("identify run.csv", "run.csv: no column for"),
    ("export model.json --to mjcf", "cannot hold cogging"),
    ("export model.json --to c --check run.csv", "--check goes with mjcf or feedforward, not with c"),
    ("export model.json --to feedforward --armature 0.1", "--armature goes with mjcf or snippet, not with feedforward"),
    ("export model.json --to snippet --drive output=duty,kp=0.5,gain=1", "is a share of the bus: say its voltage"),
    ("export model.json --to python --drive output=duty,kp=0.5,gain=1", "is a share of the bus: say its voltage"),
    ("app none.csv --no-browser", "there is no such file"),
    ("identify +none.csv", "there is no such file"),
    ("identify my+none.csv", "there is no such file"),
    ("identify none.csv+", "there is no such file"),
    ("survey empty -o out", "holds no recording"),
    ("survey run.csv -o out", "use diagnose for one recording"),
    ("identify run.csv --columns torqe=x", "did you mean torque"),
]
PLAYED = ["record", "--excitation", "suggested", "--diagnosis", "d.json", "-o", "x.csv"]
FILES = [
    *((["compare", "model.json", "run.csv"], "model.json", *case) for case in MODELS),
    *((PLAYED, "d.json", *case) for case in DIAGNOSES),
    *((["record", "--backend", "dm1015b", "--config", "rig.toml", "-o", "x.csv"], "rig.toml", *case) for case in RIGS),
]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The folder in which commands run, with files that are no recording, a model, and one without inertia."""
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("this is a letter\nand no recording\n")
    Path("table.csv").write_text("file\n\0\n")
    Path("empty").mkdir()
    hide(paper_plant(), "cogging").save("model.json")
    Path("none.json").write_text(json.dumps({**MODEL, "terms": []}))


@pytest.mark.parametrize(("argv", "name", "content", "reason"), FILES, ids=range(len(FILES)))
def test_a_document_that_cannot_be_is_refused_with_file_and_key(run_refused, argv, name, content, reason):
    Path(name).write_text(content)
    error = run_refused(*argv)
    assert name in error and reason in error


@pytest.mark.parametrize(("words", "reason"), WORDS, ids=range(len(WORDS)))
def test_words_that_make_no_sense_are_refused_with_one_line(run_refused, words, reason):
    for library in (name for word, name in (("mjcf", "mujoco"), ("app ", "dash")) if word in words):
        pytest.importorskip(library)
    assert reason in run_refused(words)


def test_a_port_that_is_taken_and_an_extra_that_is_not_there_are_told(run_refused, monkeypatch):
    pytest.importorskip("dash")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert f"port {port} is taken" in run_refused("app", "--port", port, "--no-browser")
    monkeypatch.setattr("workbench.commands.app.find_spec", lambda name: None)
    assert "pip install 'pendulum-ident[app]'" in run_refused("app", "--no-browser")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert "pip install 'pendulum-ident[export]'" in run_refused("export", "model.json", "--to", "mjcf", "-o", "out")


def write(**columns):
    np.savetxt("run.csv", np.column_stack([*columns.values()]), "%.15g", ",", header=",".join(columns), comments="")


def test_a_joint_that_only_sticks_and_angles_that_are_wrapped_are_told(run_refused, run_command):
    time = np.arange(0, 8, 1e-3)
    write(time=time, position=1e-3 * (time > 4), torque=0.1 * np.sin(time))
    for command in ("identify", "diagnose"):
        assert "motion" in run_refused(command, "run.csv", "-o", "out.json")
    position = np.angle(np.exp(1j * (3 * time + np.sin(5 * time))))
    write(time=time, position=position, torque=2 + 3 * np.sin(5 * time + 1))
    assert "--unwrap" in run_refused("identify", "run.csv")
    assert "unwrapped" in run_command("identify", "--unwrap", "run.csv", "--scheme", "filtered_power")


@pytest.mark.parametrize(("column", "value"), [("torque", 1e308), ("time", 1e300), ("velocity", 1e308)])
def test_numbers_that_nothing_measures_are_left_out_with_their_row(run_command, column, value):
    time = np.arange(300) / 100
    columns = {"time": time, "position": np.sin(3 * time), "torque": 2 + np.cos(time), "velocity": 3 * np.cos(3 * time)}
    columns[column][150] = value
    write(**columns)
    assert f"{column} is infinite in data row 151: left out" in run_command("identify", "run.csv")


def test_time_that_would_become_billions_of_samples_is_refused(run_refused):
    time = np.concatenate([np.arange(400) * 1e-7, 1.0 + 10.0 * np.arange(50)])
    write(time=time, position=np.sin(time), torque=np.cos(time))
    assert "450 samples would become 4.91e+09 on uniform time" in run_refused("identify", "run.csv")


@pytest.mark.parametrize(
    "options",
    [
        ["--amplitude", "1e6"],
        ["--theta", "gravity=1e9,inertia=1e-9"],
        ["--effect", "quadratic_drag=1e9"],
    ],
    ids=" ".join,
)
def test_the_largest_numbers_that_are_taken_give_no_warning(capsys, options):
    assert main(["record", "--seconds", "1.5", *options, "-o", "run.csv"]) in (0, 2)
    assert capsys.readouterr().err.count("\n") <= 1


def test_a_sentence_is_short_and_holds_nothing_that_a_terminal_obeys() -> None:
    told = format_mistake(InputError(f"a{'b' * 1000}c \x1b[31m\n\td"))
    assert len(told) < LONGEST and told.startswith("ab") and told.endswith("bc \\x1b[31m d") and " ... " in told
    assert format_mistake(InputError("plain ± text")) == "plain ± text"
