"""The command line end to end, through `main`."""

import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

import estimators.arguments
from estimators import diagnose
from pendulum_env.formatting import typeset
from pendulum_env.physics import Model, effects
from pendulum_env.physics.effect_texts import find_description
from pendulum_env.physics.table import TABLES
from pendulum_env.recording import read_recording
from workbench.cli import COMMANDS, main
from workbench.commands.demo import judge_diagnosis

FEW = ("torque_offset", "coulomb_asymmetry", "stribeck", "quadratic_drag", "cogging")  # a search among them is quick


@pytest.fixture
def few_effects(monkeypatch):
    known = {id: effects()[id] for id in FEW}
    monkeypatch.setattr(estimators.arguments, "list_nameable", lambda: known)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """Folder with `train.csv` and `holdout.csv` of a pendulum with hidden Stribeck friction, and its base model."""
    folder = tmp_path_factory.mktemp("runs")
    for seed, name in enumerate(("train", "holdout")):
        command = ["record", "--effect", "stribeck=0.4", "--seconds", "8", "--seed", str(seed)]
        assert main([*command, "-o", str(folder / f"{name}.csv")]) == 0
    assert main(["identify", str(folder / "train.csv"), "-o", str(folder / "base.json")]) == 0
    return folder


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def runs(recorded, here):
    """The same files where commands run."""
    for file in recorded.iterdir():
        shutil.copy(file, ".")


def held(name):
    return json.loads(Path(name).read_text())


def test_version_and_commands_are_said(run_command):
    assert re.fullmatch(r"pendulum-ident (\d+\.\d+\S*|\(not installed\))\n", run_command("--version"))
    assert all(
        name in run_command("--help") and "--plugin FILE.py" in run_command(f"{name} --help") for name in COMMANDS
    )


def test_record_writes_what_can_be_read_says_what_is_hidden_and_repeats_itself_with_the_same_seed(run_command):
    asked = "record --seconds 2 --rate 500 --excitation prbs --theta inertia=0.1"
    for name, seed in (("one", 0), ("again", 0), ("other", 1)):
        hidden = "--effect cogging:order=9 --effect spring"
        assert "hidden: cogging, spring" in run_command(f"{asked} {hidden} --seed {seed} -o {name}.csv")
    recording = read_recording("one.csv")
    assert len(recording) == 1000 and recording.rate == pytest.approx(500)
    one, again, other = (Path(f"{name}.csv").read_bytes() for name in ("one", "again", "other"))
    assert one == again != other


def test_degrees_change_what_is_printed_and_drawn_and_no_file(runs, run_command):
    said, files = {}, {}
    for unit, option in (("rad", ""), ("deg", "--degrees")):
        said[unit] = run_command(f"compare base.json holdout.csv --json {unit}.json --report {unit}.html {option}")
        files[unit] = Path(f"{unit}.html").read_text()
    assert held("rad.json") == held("deg.json")
    rad, deg = (re.findall(rf"([\d.]+).{unit} in free run", files[unit])[0] for unit in said)
    assert float(deg) == pytest.approx(np.degrees(float(rad)), rel=0.01)
    assert "[rad]" in said["rad"] and "[rad]" not in said["deg"] and "velocity q' [rad/s]" not in files["deg"]


def test_identify_prints_six_schemes_and_saves_a_model(runs, run_command):
    out = run_command("identify train.csv -o model.json --json found.json")
    schemes = ("dynamic", "filtered_dynamic", "energy", "filtered_power", "hamiltonian", "filtered_hamiltonian")
    assert all(any(line.startswith(f"{scheme} ") for line in out.splitlines()) for scheme in schemes)
    assert Model.load("model.json").estimates["inertia"].value == pytest.approx(0.0895, rel=0.02)
    data = held("found.json")
    assert data["schema"] == "pendulum-ident/identification@3" and set(data["schemes"]) == set(schemes)
    assert data["schemes"]["energy"]["residual"]["unit"] == "J"
    assert data["schemes"]["dynamic"]["theta"]["inertia"]["unit"] == "kg m^2"
    out = run_command("identify train.csv --scheme filtered_power --columns position=position:m,torque=torque:N")
    assert "filtered_power" in out and "hamiltonian" not in out
    assert "inertia [kg]" in out and "gravity [N]" in out  # of a joint that slides


def test_a_recording_at_rest_is_left_out_beside_one_with_motion(runs, run_command, capsys):
    rows = [f"{k / 200},0.05,{0.02 * np.sin(k / 50):.5f}" for k in range(800)]
    Path("rest.csv").write_text("\n".join(["time,position,torque", *rows]))
    assert "warning: rest.csv: position is 0.05 rad" in run_command(
        "compare base.json rest.csv train.csv --json both.json"
    )
    run_command("compare base.json train.csv --json moving.json")
    assert held("both.json") == held("moving.json")
    assert main(["identify", "rest.csv"]) == 2
    assert "rest.csv" in capsys.readouterr().err


def test_compare_says_how_far_off_and_where_and_writes_a_report(runs, run_command):
    out = run_command("compare base.json train.csv holdout.csv --json c.json --report c.html")
    assert "\x1b" not in out  # plain where nobody watches
    assert "For q' from" in out and "more than 100 standard errors" in out
    assert re.search(r"mean residual \[N m\]", out) and re.search(r"█│ *$", out, re.M)
    low, high = re.search(r"For q' from (\S+) to (\S+) rad/s", out).groups()
    assert re.search(rf"^{low} to ", out, re.M) and re.search(rf" to {high} ", out)  # ends of rows of the table
    data = held("c.json")
    assert [item["name"] for item in data["recordings"]] == ["train", "holdout"]
    assert max(region["significance"] for region in data["regions"]) > 100
    assert data["joint"]["errors"]["torque_rms"] > 3 * data["joint"]["noise_floor"]["torque_rms"]
    axes = {"position", "velocity", "torque", "time", "frequency", "order"}
    assert {item["axis"] for item in data["profiles"]} == axes
    told = Path("c.html").read_text(encoding="utf-8")
    assert "The model is off by" in told and "base model" not in told and "Where it fails" in told


@pytest.mark.parametrize(
    "line", ["identify train.csv", "compare base.json holdout.csv", "compare base.json --report c.html holdout.csv"]
)
def test_json_alone_goes_to_standard_output(runs, line, capsys):
    """The same as in a file; a pipe reads one JSON document, and a person the texts on standard error."""
    assert main([*line.split(), "--json", "there.json"]) == 0
    printed = capsys.readouterr().out
    for output in ("-", "/dev/stdout"):
        assert main([*line.split(), "--json", output]) == 0
        out = capsys.readouterr()
        assert json.loads(out.out) == held("there.json")
        assert (
            out.err.strip()
            == printed.replace("wrote there.json and ", "wrote ").replace("wrote there.json", "").strip()
        )
    assert not Path("-").exists()


def test_diagnose_finds_the_hidden_effect_and_writes_everything(runs, few_effects, monkeypatch, run_command):
    made = []  # once for both ways to tell it
    monkeypatch.setattr(
        "workbench.commands.diagnose.diagnose",
        lambda *some, **options: made.append(diagnose(*some, **options)) or made[0],
    )
    line = "diagnose train.csv --holdout holdout.csv --json d.json --report d.html -o m.json"
    out = run_command(line)
    brief = out.partition("\n\n")[2].splitlines()
    assert brief[:2] == ["Stribeck friction is missing", f"stribeck: {effects()['stribeck'].law}"]
    assert re.search(r"^stribeck +0\.\d+ ± 0\.\d+ +N m *$", out, re.M)
    assert len(brief) <= 14  # its table of six parameters included
    monkeypatch.setattr("workbench.commands.diagnose.diagnose", lambda *_, **__: made[0])
    out = run_command("diagnose train.csv --holdout holdout.csv -v")
    assert "+ stribeck" in out and "█" in out and re.search("^score: probability", out, re.M)
    assert re.search("^stribeck +selected ", out, re.M) and re.search("^cogging +rejected ", out, re.M)
    assert held("d.json")["selected"] == ["stribeck"] and Model.load("m.json").effects == ("stribeck",)
    page = Path("d.html").read_text(encoding="utf-8")
    assert page.lstrip().lower().startswith("<!doctype html>") and f"<code>pendulum-ident {line}</code>" in page


def test_a_horizon_is_in_what_compare_and_diagnose_write(runs, few_effects, run_command):
    out = run_command("compare base.json train.csv --horizon 3 --json c.json --report c.html")
    assert "over 3 s" in out and held("c.json")["horizon"] == 3.0
    assert "over 3 s" in Path("c.html").read_text(encoding="utf-8")
    out = run_command(
        "diagnose train.csv --holdout holdout.csv --horizon 3 --only cogging --json d.json --report d.html -o m.json"
    )
    refit = held("d.json")["horizon"]
    after = refit["after" if refit["kept"] else "before"]["theta"]
    assert refit["text"] in out and typeset(refit["text"]) in html.unescape(Path("d.html").read_text(encoding="utf-8"))
    assert Model.load("m.json")["coulomb"].value == pytest.approx(after["coulomb"]["value"])


@pytest.mark.parametrize(("option", "limit"), [("", 0.05), (" --significance 0.01", 0.01)])
def test_diagnose_judges_gains_by_the_significance_that_is_asked_for(runs, few_effects, run_command, option, limit):
    run_command(f"diagnose train.csv --holdout holdout.csv --json d.json{option}")
    found = held("d.json")
    gates = [gate for one in found["candidates"] for gate in one["gates"] if gate["name"] == "p_value"]
    assert found["selected"] == ["stribeck"] and len(gates) > 1
    assert all(gate["limit"] == limit and gate["passed"] == (gate["value"] <= limit) for gate in gates)


def test_record_plays_what_a_diagnosis_suggests(monkeypatch, run_command):
    """Small swings under gravity look like a spring: the next experiment goes further, and no doubt is left."""
    known = {id: effects()[id] for id in ("spring", "gravity_tilt")}
    monkeypatch.setattr(estimators.arguments, "list_nameable", lambda: known)
    plant = "--theta coulomb=0.2,viscous=0.2 -o"
    run_command(f"record --seconds 8 --amplitude 1 {plant} first.csv")
    outputs = "--json d.json --experiment torque.csv --report report.html"
    out = run_command(f"diagnose first.csv {outputs} --max-torque 4 --max-angle 2.5 --max-speed 20")
    assert "To tell a spring from gravity: record 20 s of" in out
    suggestion = held("d.json")["suggestion"]
    assert suggestion["settles"] == [{"effect": "spring", "instead": "gravity"}] and suggestion["peak_torque"] <= 4
    run_command(f"record --excitation suggested --diagnosis d.json {plant} next.csv")
    played = read_recording("next.csv")
    assert played.duration == pytest.approx(suggestion["seconds"], abs=0.01)
    assert np.abs(played.torque).max() == pytest.approx(suggestion["peak_torque"], abs=0.1)
    assert np.abs(played.position).max() <= 2.5
    assert np.ptp(played.position) == pytest.approx(np.ptp(suggestion["reach"]), rel=0.1)
    written = np.genfromtxt("torque.csv", delimiter=",", names=True)
    sent = np.interp(written["time"], played.time, played.torque)
    assert np.sqrt(np.mean((sent - written["torque"]) ** 2)) < 0.1 * np.std(sent)  # what is played, noise aside
    assert "The next experiment" in Path("report.html").read_text()
    assert "none.csv is not written" in run_command("diagnose first.csv next.csv --json d.json --experiment none.csv")
    assert held("d.json")["suggestion"] is None and not Path("none.csv").exists()


def test_demo_tells_the_story_and_reveals_the_truth(tmp_path, few_effects, monkeypatch, run_command):
    monkeypatch.setattr("workbench.commands.demo.SECONDS", 8.0)
    out = run_command("demo --seed 3 -o report.html")
    assert out.index("missing") < out.index("held-out error") < out.index("The truth") < out.index("hidden was")
    assert {file.name for file in tmp_path.iterdir()} == {"report.html", "report.train.csv", "report.holdout.csv"}


@pytest.mark.parametrize(
    ("selected", "ambiguous", "told"),
    [
        (["spring"], (), "found"),
        (["stribeck"], (("stribeck", "spring"),), "found as one of a group that looks the same: spring and stribeck"),
        (["stribeck"], (), "NOT found as it is: the diagnosis says stribeck"),
        ([], (), "NOT found as it is: the diagnosis says nothing"),
    ],
)
def test_the_verdict_of_the_demo_is_honest(selected, ambiguous, told):
    assert judge_diagnosis("spring", selected, ambiguous) == told


def test_effects_are_listed_with_their_laws_or_told_how_they_show(run_command):
    out = run_command("effects")
    assert all(id in out and kind.law in out for id, kind in effects().items())
    out = run_command("effects", "backlash", *TABLES)
    assert find_description("backlash").signature in out and "joint flexibility" in out and "stribeck:" not in out
    for id, table in TABLES.items():
        assert f"{id}: {table.law}\n" in out and str(table.__doc__).partition("\n")[0] in out


@pytest.mark.parametrize("before", [None, "older"])
def test_a_model_that_no_body_has_is_not_written(runs, capsys, before):
    if before is not None:
        Path("m.json").write_text(before)
    assert main("identify train.csv --columns torque=-torque -o m.json".split()) == 2
    reason = " ".join(capsys.readouterr().err.split())
    assert "m.json is not written" in reason and "torque and position have opposite signs" in reason
    assert "(-0." in reason and "--columns torque=torque" in reason
    assert (Path("m.json").read_text() if Path("m.json").exists() else None) == before


def test_interrupting_ends_with_one_line(runs, tmp_path, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("workbench.commands.diagnose.diagnose", interrupt)
    before = {*tmp_path.iterdir()}
    assert main(["diagnose", "train.csv", "-o", "m.json"]) == 130
    assert capsys.readouterr().err == "pendulum-ident: interrupted\n"
    assert {*tmp_path.iterdir()} == before
