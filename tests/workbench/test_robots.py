"""Robots as they come, three with grippers and one with a torso that slides, through all commands."""

import json
import re

import pytest

from tests import robots, slow
from workbench.cli import main

pytest.importorskip("mujoco")

MOVING = {
    "parallel": ("shoulder", "elbow"),
    "angular": ("shoulder", "elbow", "wrist"),
    "driven": ("shoulder", "jaw"),
    "torso": ("torso", "shoulder", "elbow"),
}


@pytest.mark.parametrize("robot", slow.but_first(["torso", "parallel", "angular", "driven"]))
def test_a_robot_goes_through_all_commands(robot, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    joints, at = MOVING[robot], MOVING[robot][-1]
    (tmp_path / "robot.urdf").write_text(robots.urdf(getattr(robots, robot.upper())))
    asked = ["--robot", "robot.urdf"]
    moving = [*asked, "--joints", ",".join(joints)]

    def run(*words):
        assert main(list(words)) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    usual = ("--seconds", "10", "--rate", "250", "--backend", "mujoco")
    run("record", *moving, *usual, "-o", "plain.csv")
    out = run("record", *moving, *usual, "--seed", "1", "--effect", f"torque_offset@{at}=1.5", "-o", "hidden.csv")
    assert f"hidden: torque_offset@{at}" in out and ("held: left at zero" in out) == (robot != "driven")
    run("identify", "plain.csv", *moving, "--scheme", "filtered_dynamic", "-o", "model.json")
    out = run("compare", "model.json", "hidden.csv", *moving, "--report", "compared.html")
    assert re.search(rf"^{at} ", out, re.M)
    found = ("--only", "torque_offset,quadratic_drag", "--report", "found.html", "-o", "better.json")
    assert f"Missing: torque_offset@{at}" in run("diagnose", "hidden.csv", *moving, *found)
    theta = json.loads((tmp_path / "better.json").read_text())["theta"]
    assert theta[f"torque_offset@{at}"]["value"] == pytest.approx(1.5, rel=0.02)
    looked = ("--only", f"spring@{at}", "--json", "again.json")
    run("diagnose", "hidden.csv", *moving, "--model", "better.json", *looked)
    candidates = json.loads((tmp_path / "again.json").read_text())["candidates"]
    assert [one["effect"] for one in candidates] == [f"spring@{at}"]
    assert "lowers" in run("add", "model.json", f"torque_offset@{at}", "hidden.csv", *moving)
    for form in ("mjcf", "urdf"):
        run("export", "model.json", *asked, "--to", form, "-o", f"model.{form}")
    out = run("compare", "model.json", "plain.csv", "--robot", "model.urdf")  # what moved in the first one
    assert all(float(line.split()[-2]) < 5 for line in out.splitlines() if line.endswith(" %"))
