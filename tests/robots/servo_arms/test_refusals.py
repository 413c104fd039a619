"""Input that arms of servos do not take is refused in one sentence."""

import json

import numpy as np
import pytest

from estimators import diagnose, identify
from pendulum_env.errors import UserError
from pendulum_env.physics import Model, find_term
from pendulum_env.physics.base import Coulomb, Inertia, Viscous
from pendulum_env.physics.joints import find_kinds
from pendulum_env.recording.study import read_sources
from robots.arms import arm_base, place_term
from robots.arms.body import read_body
from robots.arms.model import ArmModel
from robots.arms.reading import read_arm_source
from robots.servo_arms.case import SERVO_ARM
from robots.servo_arms.model import ServoArmModel
from tests.robots.servo_arms.simulated_arm import DRY, JOINTS, ROTOR, VISCOUS, write_arm


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    write_arm(folder, np.random.default_rng(0), runs=2, seconds=3.0)
    servo = Model.build((Inertia(), Viscous(), Coulomb()), [ROTOR, VISCOUS, DRY])
    model = ServoArmModel.join(dict.fromkeys(JOINTS, servo), read_body(folder / "arm.urdf"))
    (folder / "model.json").write_text(json.dumps(model.json()))
    return folder


@pytest.fixture(scope="module")
def arms(folder):
    return [read_arm_source(source, JOINTS) for source in read_sources(folder / "arm.toml")]


@pytest.fixture
def refuse(folder, run_refused, monkeypatch):
    monkeypatch.chdir(folder)
    return lambda words, robot="arm.urdf": run_refused(*words.split(), "--robot", robot)


def test_columns_of_other_links_are_named(folder, refuse):
    content = json.loads((folder / "model.json").read_text())
    content["servos"]["wrist"]["terms"].append("links")
    content["servos"]["wrist"]["theta"]["links.mx_hand"] = {"value": 0.1}
    (folder / "other.json").write_text(json.dumps(content))
    assert "links.mx_hand" in refuse("compare other.json arm.toml")


@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_linear_joints_are_refused(folder, refuse, command):
    text = (folder / "arm.urdf").read_text()
    (folder / "linear.urdf").write_text(text.replace('name="wrist" type="revolute"', 'name="wrist" type="prismatic"'))
    assert "'wrist' is linear" in refuse(f"{command} arm.toml", "linear.urdf")


@pytest.mark.parametrize("effect", ["torque_by_angle@wrist", "coupling@elbow,wrist"])
def test_effects_that_no_servo_has_are_refused_with_known_ones(refuse, effect):
    assert "stribeck" in refuse(f"add model.json {effect} arm.toml")


def test_a_diagnosis_tries_the_quick_effects_of_a_joint_alone(folder, arms):
    body = read_body(folder / "arm.urdf")
    library = {kind.id: kind for kind in find_kinds(["stribeck@lift", "cogging@lift", "cogging@wrist"], body)}
    assert set(SERVO_ARM.select_quick(library)) == {"stribeck@lift", "cogging@wrist"}
    part = SERVO_ARM.divide(arm_base(body), arms, library=library)["lift"]
    assert set(part.library) == {"stribeck", "cogging"}  # as `add` needs


def test_arguments_without_effect_are_refused(folder, arms, refuse):
    assert "schemes" in refuse("identify arm.toml --scheme energy")
    base = arm_base(read_body(folder / "arm.urdf"))
    longer = (*base, place_term(find_term("stribeck")(), "lift"))
    with pytest.raises(UserError, match="stribeck@lift"):
        identify(arms, longer)
    with pytest.raises(UserError, match="stribeck@lift"):
        diagnose(arms, base=longer)
    with pytest.raises(UserError, match="bounds of an experiment"):
        diagnose(arms, base=base, max_torque=1.0)


def test_a_model_of_torques_is_no_model_of_servos(folder, refuse):
    base = arm_base(read_body(folder / "arm.urdf"))
    model = ArmModel.build(base, [0.1] * sum(len(term.columns) for term in base))
    (folder / "torques.json").write_text(json.dumps(model.json()))
    for words in ("compare torques.json arm.toml", "add torques.json stribeck@lift arm.toml"):
        assert "the recordings are of servos" in refuse(words)


def test_a_robot_with_other_names_of_joints_is_refused_by_its_joints(folder, refuse):
    """A drive of a joint that the log has, but the robot has not, is not the cause."""
    (folder / "renamed.urdf").write_text((folder / "arm.urdf").read_text().replace('"elbow"', '"joint_2"'))
    (folder / "drive.toml").write_text((folder / "arm.toml").read_text() + "\n[drive.elbow]\nkp = 3.0\n")
    message = refuse("diagnose drive.toml", "renamed.urdf")
    assert "elbow' is of no joint of the robot" in message and "joint_2" in message
