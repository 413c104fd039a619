"""Arms of servos: a hidden effect is named at its joint, from goals and positions alone."""

import json

import numpy as np
import pytest

from tests.robots.servo_arms.simulated_arm import DRY, JOINTS, KP, ROTOR, VISCOUS, write_arm
from workbench.cli import main

TRIED = "stribeck,load_dependent_friction,quadratic_drag"
HIDDEN = [("load_dependent_friction", "elbow"), ("stribeck", "lift"), ("quadratic_drag", "wrist")]


def diagnose(folder, rng, effect, at, *options, **arm):
    robot, study = write_arm(folder, rng, effect, at, **arm)
    out = folder / "out.json"
    assert main(["diagnose", str(study), "--robot", str(robot), "--json", str(out), *options]) == 0
    return json.loads(out.read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arm")


@pytest.fixture(scope="module")
def result(folder):
    options = "--only", TRIED, "-o", str(folder / "model.json")
    return diagnose(folder, np.random.default_rng(1), "load_dependent_friction", "elbow", *options, seconds=12.0)


def test_effect_is_named_at_its_joint_though_zeros_are_wrong(result):
    assert result["selected"] == ["load_dependent_friction@elbow"]
    value = result["model"]["theta"]["load_dependent_friction@elbow"]
    assert abs(value["value"] - 0.25) < 4 * value["std"] + 0.02


def test_parameters_of_servos_are_those_of_the_arm(result):
    theta = {name: estimate["value"] for name, estimate in result["model"]["theta"].items()}
    for at in JOINTS:
        assert theta[f"viscous@{at}"] == pytest.approx(VISCOUS, rel=0.1)
        assert theta[f"coulomb@{at}"] == pytest.approx(DRY, rel=0.2)
    assert theta["inertia@wrist"] == pytest.approx(ROTOR, rel=0.3)


def test_errors_in_the_loop_are_given_by_joint(result):
    before, after = (step["errors"]["holdout"]["joints"] for step in (result["steps"][0], result["steps"][-1]))
    assert after["elbow"]["in_loop"] < 0.4 * before["elbow"]["in_loop"]
    assert all(after[at]["in_loop"] < 0.0015 and 0 < after[at]["share"] < 0.005 for at in JOINTS)


def test_model_file_gives_the_same_errors_in_compare(result, folder):
    out = folder / "compared.json"
    words = ["compare", folder / "model.json", folder / "run3.csv", "--robot", folder / "arm.urdf", "--json", out]
    assert main([str(word) for word in words]) == 0
    joints, last = json.loads(out.read_text())["joint"]["errors"]["joints"], result["steps"][-1]
    for at in JOINTS:
        assert joints[at]["in_loop"] == pytest.approx(last["errors"]["holdout"]["joints"][at]["in_loop"], rel=0.05)


def test_noise_floor_of_add_is_that_of_the_diagnosis(result, folder):
    out = folder / "added.json"
    words = ["add", folder / "model.json", "stribeck@wrist", folder / "arm.toml", "--robot", folder / "arm.urdf"]
    assert main([str(word) for word in [*words, "--json", out]]) == 0
    floor = json.loads(out.read_text())["noise_floor"]["joints"]["wrist"]
    assert floor == pytest.approx(result["noise_floor"]["joints"]["wrist"], rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(10))
def test_hidden_effect_is_named_in_most_draws(tmp_path, draw):
    effect, at = HIDDEN[draw % 3]
    found = diagnose(tmp_path, np.random.default_rng(draw), effect, at, "--only", TRIED)["selected"]
    assert found == [f"{effect}@{at}"]


@pytest.mark.slow
@pytest.mark.parametrize("draw", range(5))
def test_nothing_is_named_without_an_effect(tmp_path, draw):
    assert diagnose(tmp_path, np.random.default_rng(100 + draw), "", "lift", "--only", TRIED)["selected"] == []


def test_drive_of_one_joint_is_a_table_and_unknown_joints_are_refused(tmp_path, capsys):
    robot, study = write_arm(tmp_path, np.random.default_rng(0), runs=2, seconds=3.0)
    study.write_text(study.read_text().replace("[[recording]]", f"[drive.elbov]\nkp = {KP}\n[[recording]]", 1))
    assert main(["diagnose", str(study), "--robot", str(robot)]) == 2
    assert "elbow" in capsys.readouterr().err


def test_missing_goal_of_a_joint_is_named(tmp_path, capsys):
    robot, _ = write_arm(tmp_path, np.random.default_rng(0), runs=1, seconds=3.0)
    log = tmp_path / "run0.csv"
    log.write_text(log.read_text().replace("goal_wrist", "gaol_wrist"))
    assert main(["diagnose", str(log), "--robot", str(robot), "--drive", f"output=torque,kp={KP}"]) == 2
    assert "goal_wrist" in capsys.readouterr().err
