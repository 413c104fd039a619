"""A study in the place of recordings: every command that reads recordings takes one."""

import json
from pathlib import Path

import numpy as np
import pytest

from pendulum_env.backends import record
from pendulum_env.excitation import excitation
from pendulum_env.recording import write_recording
from workbench.cli import main

CURRENT = 0.091  # [N m/A]
GEAR = 6.0

STUDY = f"""\
[columns]
position = "-motor:counts/4096/{GEAR:g}+90:deg"
torque = "i:A*{CURRENT}"

[[recording]]
file = "monday.csv"

[[recording]]
file = "tuesday.csv"
role = "holdout"
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """Two recordings of a servo as its drive logs them, and a study that says so."""
    folder = tmp_path_factory.mktemp("bench")
    for seed, name in enumerate(("monday", "tuesday")):
        rng = np.random.default_rng(seed)
        run = record(None, excitation("paper", rng, 10.0), 10.0, rng=rng)
        motor = np.round(-(run.position - np.pi / 2) * GEAR * 4096 / (2 * np.pi))
        rows = np.column_stack([run.time, motor, run.torque / CURRENT])
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="t,motor,i", comments="", fmt="%.9g")
    (folder / "study.toml").write_text(STUDY)
    return folder


def test_identify_fits_what_is_to_be_fitted_and_compare_takes_all_of_a_study(bench, tmp_path, capsys):
    assert main(["identify", str(bench / "study.toml"), "-o", str(tmp_path / "model.json")]) == 0
    told = capsys.readouterr().out
    assert "monday.csv: 10 s at 1000 Hz" in told and "tuesday.csv" not in told
    assert f"torque is i:A*{CURRENT}" in told
    theta = json.loads((tmp_path / "model.json").read_text())["theta"]
    np.testing.assert_allclose([theta[name]["value"] for name in ("inertia", "gravity")], [0.0895, 2.01], rtol=0.01)
    assert main(["compare", str(tmp_path / "model.json"), str(bench / "study.toml")]) == 0
    told = capsys.readouterr().out
    assert "monday.csv: " in told and "tuesday.csv: " in told


def test_a_missing_recording_is_refused_before_any_is_read_even_if_it_is_only_held_out(tmp_path, refused):
    (tmp_path / "study.toml").write_text(
        "[[recording]]\nfile = 'a.csv'\n[[recording]]\nfile = 'b.csv'\nrole = 'holdout'"
    )
    write_recording(record(None, excitation("paper", 1), 1.0, rng=1), tmp_path / "a.csv")
    assert "b.csv: there is no such file: check the path" in refused("identify", tmp_path / "study.toml")


@pytest.mark.parametrize(
    ("argv", "match"),
    [
        (["identify", "study.toml", "--unwrap"], "study.toml: says itself how its recordings are read"),
        (["identify", "study.toml", "--columns", "torque=i*2"], "study.toml: says itself how its recordings are read"),
        (["identify", "study.toml", "-o", "monday.csv"], "monday.csv: is one of the inputs"),
        (["identify", "study.toml", "-o", "study.toml"], "study.toml: is one of the inputs"),
        (["diagnose", "study.toml", "--holdout", "tuesday.csv"], "tuesday.csv: is named twice"),
        (["diagnose", "study.toml", "--holdout", "study.toml"], "monday.csv: is named twice"),
        (["identify", "bad.toml"], "bad.toml, recording 1: unknown key 'roll'"),
        (["identify", "held.toml"], "held.toml: holds every recording out"),
        (["identify", "none.toml"], "none.toml: cannot be read"),
        (["identify", "gone.toml"], "gone.csv: there is no such file"),
        (
            ["identify", "monday.csv", "--columns", "position=motor:rad,torque=i"],
            "torque cannot be column 'i' without a gain",
        ),
        (["identify", "monday.csv", "--columns", "position=motor:counts,torque=i*2"], "position=motor:counts/4096"),
    ],
)
def test_mistakes_are_one_line(bench, refused, argv, match, monkeypatch):
    monkeypatch.chdir(bench)
    Path("bad.toml").write_text("[[recording]]\nroll = 'fit'")
    Path("held.toml").write_text("[[recording]]\nfile = 'monday.csv'\nrole = 'holdout'")
    Path("gone.toml").write_text("[[recording]]\nfile = 'gone.csv'")
    before = Path("monday.csv").read_bytes()
    assert match in refused(*argv)
    assert Path("monday.csv").read_bytes() == before
