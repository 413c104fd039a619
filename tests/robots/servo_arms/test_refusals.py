"""Input that arms of servos do not take is refused in one sentence."""

import json

import numpy as np
import pytest

from pendulum_env.physics import Model
from pendulum_env.physics.base import Coulomb, Inertia, Viscous
from robots.arms.body import read_body
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
