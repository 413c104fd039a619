"""Logs of a bench: a study or a model file says how they are read, the next is read alike, and loads tell gains."""

import html
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import add, compare, identify
from pendulum_env.physics import Model
from pendulum_env.recording import RecordingError, read_recording
from workbench.cli import main

COLUMNS = "time=clock:ms,position=-Winkel [deg]-20,torque=i:A*0.5"
TABLE = '[columns]\ntime = "clock:ms"\nposition = "-Winkel [deg]-20"\ntorque = "i:A*0.5"\n'  # the same in a study


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Logs of a bench in its own format, and plain ones of the same motion; a model of the first."""
    folder = tmp_path_factory.mktemp("bench")
    for seed, name in enumerate(("monday", "tuesday")):
        plain = folder / f"plain-{name}.csv"
        recorded = ["record", "--seconds", "6", "--rate", "500", "--seed", str(seed), "-o", str(plain)]
        assert main(recorded) == 0
        run = read_recording(plain)
        rows = np.column_stack([1e3 * run.time, -np.degrees(run.position) - 20, 2 * run.torque])
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="clock,Winkel [deg],i", comments="", fmt="%.12g")
    model = str(folder / "model.json")
    assert main(["identify", str(folder / "monday.csv"), "--columns", COLUMNS, "-o", model]) == 0
    entries = '[[recording]]\nfile = "monday.csv"\n[[recording]]\nfile = "tuesday.csv"\nrole = "holdout"\n'
    (folder / "study.toml").write_text(f"{TABLE}{entries}")
    (folder / "bad.toml").write_text("[[recording]]\nroll = 'fit'")
    (folder / "held.toml").write_text("[[recording]]\nfile = 'monday.csv'\nrole = 'holdout'")
    (folder / "gone.toml").write_text(entries.replace("tuesday", "gone"))
    known = json.loads((folder / "model.json").read_text())
    for name, kept in (("text", "clock"), ("drive", {"drive": {"preset": "x"}})):
        (folder / f"{name}.json").write_text(json.dumps(known | {"log_format": kept}))
    return folder


def test_identify_fits_what_is_to_be_fitted_and_compare_takes_all_of_a_study(bench, tmp_path, run_command):
    told = run_command("identify", bench / "study.toml", "-o", tmp_path / "model.json")
    assert "monday.csv: 6 s at 500 Hz" in told and "tuesday.csv" not in told and "torque is i:A*0.5" in told
    assert Model.load(tmp_path / "model.json").estimates == Model.load(bench / "model.json").estimates
    told = run_command("compare", tmp_path / "model.json", bench / "study.toml")
    assert "monday.csv: " in told and "tuesday.csv: " in told


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("identify study.toml --unwrap", "study.toml: is a study with reading options"),
        ("identify study.toml -o study.toml", "study.toml: is one of the inputs"),
        ("diagnose study.toml --holdout tuesday.csv", "tuesday.csv: is named twice"),
        ("identify bad.toml", "bad.toml: 'recording[0]': unknown key 'roll'"),
        ("identify held.toml", "held.toml: holds every recording out"),
        ("identify gone.toml", "gone.csv: there is no such file: check the path"),  # even if it is only held out
        ("identify monday.csv --columns time=clock:ms,torque=i", "torque cannot be column 'i' without a gain"),
        ("compare text.json monday.csv", "text.json: 'log_format': Expected object"),
        ("compare drive.json monday.csv", "log_format: "),
    ],
)
def test_mistakes_about_studies_are_one_line(bench, run_refused, words, match, monkeypatch):
    monkeypatch.chdir(bench)
    before = Path("monday.csv").read_bytes()
    assert match in run_refused(*words.split())
    assert Path("monday.csv").read_bytes() == before


def test_the_next_log_of_the_format_is_read_alike(bench, tmp_path, run_command):
    model, log = str(bench / "model.json"), str(bench / "tuesday.csv")
    out = run_command("compare", model, log)
    assert f"read as {model} says: time=clock:ms, position=-Winkel [deg]-20 and torque=i:A*0.5" in out
    as_told = out.partition("Errors of")[2]
    out = run_command("compare", model, log, "--columns", COLUMNS)
    assert "read as" not in out and out.partition("Errors of")[2] == as_told
    added = tmp_path / "added.json"
    assert main(["add", model, "torque_offset", log, "-o", str(added)]) == 0
    assert Model.load(added).log_format == Model.load(model).log_format != {}


def test_columns_that_are_said_count_and_a_log_that_does_not_fit_is_one_sentence(bench, run_refused):
    model, log = str(bench / "model.json"), str(bench / "plain-tuesday.csv")
    said = run_refused("compare", model, log)
    assert "no column is named 'clock', which is to be time" in said
    assert f"read as {model} says: name the columns of a log of another format, --columns QUANTITY=NAME" in said
    assert main(["compare", model, log, "--columns", "torque=torque"]) == 0


def test_a_study_says_it_itself_and_what_is_alike_in_it_is_kept(bench, tmp_path):
    load = "load = {inertia = 0.0, gravity = 0.0}"
    entries = [f"[[recording]]\nfile = {json.dumps(str(bench / f'{day}.csv'))}\n" for day in ("monday", "tuesday")]
    for name, told in (("alike", [load, load]), ("apart", [load, ""])):
        both = "\n".join(entry + more for entry, more in zip(entries, told, strict=True))
        (tmp_path / f"{name}.toml").write_text(f"{TABLE}{both}\n")
        model = tmp_path / f"{name}.json"
        assert main(["identify", str(tmp_path / f"{name}.toml"), "-o", str(model)]) == 0
    alike, apart = (Model.load(tmp_path / f"{name}.json").log_format for name in ("alike", "apart"))
    assert alike["columns"] == apart["columns"] == Model.load(bench / "model.json").log_format["columns"]
    assert alike["load"] == {"inertia": 0.0, "gravity": 0.0} and "load" not in apart


@pytest.mark.slow
def test_what_a_diagnosis_says_of_columns_can_be_pasted(bench, tmp_path, run_command):
    """A turned sign, then a wrong zero, and then nothing is wrong; the report has the same options."""
    page = tmp_path / "report.html"
    log = ["diagnose", str(bench / "monday.csv"), "--holdout", str(bench / "tuesday.csv")]
    option = ["--columns", "time=clock:ms,position=-Winkel [deg],torque=-i:A*0.5"]
    for told in ("opposite signs", "zero of the position is 20.0"):
        (line, *_) = (line for line in run_command(*log, *option, "--report", page).splitlines() if told in line)
        pasted = re.search(r"Read it with (--columns .*) instead\.$", line)[1]
        assert pasted in html.unescape(page.read_text(encoding="utf-8"))
        option = shlex.split(pasted)
    assert "Nothing is missing" in run_command(*log, *option, "-o", tmp_path / "m.json")


K = 0.873  # [N m/A]
ARMS = ((0.0, 0.2), (0.5, 0.2), (1.0, 0.2))  # [kg] at [m]
NEWTON_METRE = re.compile(r"(?:N|kg)(?: |\N{NO-BREAK SPACE}|&nbsp;|\\u00a0)m(?!/A)(?![a-z])")


@pytest.fixture(scope="module")
def weighed(tmp_path_factory) -> Path:
    """Currents under three loads, of friction that grows with the load, and studies of all and of one."""
    folder = tmp_path_factory.mktemp("weighed")
    friction = {"load_dependent_friction": {"load_mu": 0.12}}
    plants = [Plant(0.03 + m * r * r, 0.6 + 9.81 * m * r, 0.15, 0.25, friction) for m, r in ARMS]
    runs = [Experiment(500.0, 8.0, "two_tone", 0.7, seed, counts=65_536) for seed in range(len(ARMS))]
    cases = list(zip(plants, runs, strict=True))
    entries = []
    for k, (run, (m, r)) in enumerate(zip(simulate(cases), ARMS, strict=True)):
        rows = np.column_stack([run.time, run.position, run.torque / K])
        np.savetxt(folder / f"load{k}.csv", rows, delimiter=",", header="t,q,i", comments="", fmt="%.9g")
        entries.append(f'[[recording]]\nfile = "load{k}.csv"\nload = {{mass = {m}, length = {r}}}\n')
    columns = '[columns]\ntorque = "i:A*?"\n'
    (folder / "all.toml").write_text(columns + "".join(entries))
    (folder / "one.toml").write_text(columns + entries[1])
    return folder


FOUND = re.compile(r"torque constant 0\.87\d* ± 0\.\d+ N m/A, from 3 known loads")


def test_a_torque_constant_is_identified_kept_and_used(
    weighed, tmp_path, capsys: pytest.CaptureFixture[str], run_command
):
    study, model = str(weighed / "all.toml"), str(tmp_path / "model.json")
    assert FOUND.search(run_command("identify", study, "-o", model, "--json", tmp_path / "identified.json"))
    data = json.loads((tmp_path / "identified.json").read_text())
    assert data["torque_constant"]["value"] == pytest.approx(K, rel=0.01)
    saved = json.loads(Path(model).read_text())["torque_constant"]
    assert saved["value"] == pytest.approx(K, rel=0.01) and 0 < saved["std"] < 0.01 and saved["unit"] == "N m/A"
    assert main(["compare", model, str(weighed / "one.toml")]) == 0  # whose current alone would not tell it
    told = capsys.readouterr().out
    assert "torque constant 0.87" in told and "N m/A, of the model" in told and "torque [N m]" in told


@pytest.mark.slow
def test_without_loads_that_differ_nothing_is_said_in_newton_metres(weighed, tmp_path, run_command):
    study, model, page = str(weighed / "one.toml"), str(tmp_path / "model.json"), tmp_path / "page.html"
    told = []
    for command in (
        ["identify", study, "-o", model, "--json", str(tmp_path / "identified.json")],
        ["compare", model, study, "--json", str(tmp_path / "compared.json")],
        ["diagnose", study, "-v", "--json", str(tmp_path / "diagnosis.json"), "--report", str(page)],
        ["add", model, "stribeck", study],
    ):
        told.append(run_command(*command))
    for k in (0, 2, 3):
        assert "The torque constant is unknown, and every parameter is per A" in told[k]
    assert "inertia [A s^2]" in told[0] and "torque [A]" in told[1] and "torque, fitted [A]" in told[2]
    written = [file.read_text() for file in tmp_path.glob("*.json")]
    shown = re.sub(r'<script type="application/gzip".*?</script>', "", page.read_text(), flags=re.S)
    assert len(written) == 4
    for text in (*told, *written, shown):
        assert not NEWTON_METRE.search(text)


def test_python_reads_the_next_log_as_the_command_line(bench, monkeypatch):
    monkeypatch.chdir(bench)
    columns = {"time": "clock:ms", "position": "-Winkel [deg]-20", "torque": "i:A*0.5"}
    found = identify(read_recording("monday.csv", columns=columns)).model
    assert found.log_format == Model.load("model.json").log_format == {"columns": columns}
    model = Model.load("model.json")
    data = np.loadtxt("tuesday.csv", delimiter=",", skiprows=1).T
    table = dict(zip(("clock", "Winkel [deg]", "i"), data, strict=True))
    errors = [compare(model, own).errors for own in ("tuesday.csv", table)]
    assert errors[0].torque_rms == pytest.approx(errors[1].torque_rms)
    assert add(model, "torque_offset", "tuesday.csv").after.model.log_format == {"columns": columns}
    assert compare(model, read_recording("plain-tuesday.csv")).errors.torque_rms < 0.1
    with pytest.raises(RecordingError, match="log_format of the model"):
        compare(model, "plain-tuesday.csv")
