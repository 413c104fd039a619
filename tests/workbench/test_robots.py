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

    usual = ("--seconds", "6", "--rate", "250", "--backend", "mujoco")
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


LINK = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["identify", "plain.csv", "--robot", "robot.urdf", "--joints", "shoulder,elbo"],
            "unknown joint 'elbo'",
        ),
        (["identify", "plain.csv", "--robot", "robot.urdf"], "there is none for left"),
        (["identify", "plain.csv", "--robot", "loop.urdf"], "link 'b' hangs on two joints: closed loops"),
        (
            ["diagnose", "plain.csv", "--only", "stribeck@elbow"],
            "is an effect at a joint of an arm",
        ),
        (["identify", "plain.csv", "--no-gravity"], "--no-gravity is of an arm"),
        (["identify", "plain.csv", "--rotors"], "--rotors is of an arm"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path, capsys, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.urdf").write_text(robots.urdf(robots.PARALLEL))
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="b"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for name, parent in (("one", "ground"), ("two", "a"))
    )
    (tmp_path / "loop.urdf").write_text(
        f'<robot name="loop"><link name="ground"/><link name="a">{LINK}<link name="b">{LINK}{joints}</robot>'
    )
    header = "time,position_shoulder,position_elbow,torque_shoulder,torque_elbow\n"
    (tmp_path / "plain.csv").write_text(header + "".join(f"{k / 100},{k % 7},{k % 5},1,{k % 3}\n" for k in range(50)))
    assert main(words) == 2
    err = capsys.readouterr().err
    assert said in err and err.count("\n") == 1
