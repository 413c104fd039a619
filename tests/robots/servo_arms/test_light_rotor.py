"""A rotor without inertia is possible beside the inertia of links, and impossible without them."""

import json

import numpy as np
import pytest

from estimators.selection.physical import find_violations
from pendulum_env.physics import Model, ModelError, Samples
from pendulum_env.physics.base import Coulomb, Inertia, Viscous
from robots.arms.body import read_body
from robots.servo_arms.links import LinkTable, LinkTorque, make_link_torque
from robots.servo_arms.model import ServoArmModel
from tests.robots.servo_arms.simulated_arm import DRY, JOINTS, KP, VISCOUS, write_arm
from workbench.cli import main


def make_light_servo(body):
    """Return a servo without rotor, whose links have the inertia of a mass at the end of each."""
    names = tuple(name.replace("@", "_") for name in body.names)
    links = make_link_torque(LinkTorque, LinkTable(names, np.zeros(1), np.zeros((1, 4 * len(names)))))()
    return Model.build((Inertia(), links, Viscous(), Coulomb()), [0.0, *body.values, VISCOUS, DRY])


@pytest.fixture
def arm(tmp_path):
    robot, _ = write_arm(tmp_path, np.random.default_rng(0), runs=1, seconds=3.0)
    body = read_body(robot)
    return robot, ServoArmModel.join(dict.fromkeys(JOINTS, make_light_servo(body)), body)


def test_model_file_without_rotor_is_compared(arm, tmp_path):
    robot, model = arm
    (tmp_path / "model.json").write_text(json.dumps(model.json()))
    words = ["compare", tmp_path / "model.json", tmp_path / "run0.csv", "--robot", robot, "--json", tmp_path / "out"]
    words += ["--drive", f"output=torque,kp={KP},goal=held,reads=exact,encoder=output"]
    assert main([str(word) for word in words]) == 0
    errors = json.loads((tmp_path / "out").read_text())["joint"]["errors"]["joints"]
    assert all(errors[at]["in_loop"] < 0.05 for at in JOINTS)


def test_bounds_of_an_effect_pass_at_such_a_joint(arm):
    servo, zeros = arm[1].servos["lift"], np.zeros(5)
    x = Samples(zeros, np.linspace(-1, 1, 5), np.linspace(-1, 1, 5), zeros)
    assert "negative_inertia" not in [gate.name for gate in find_violations(servo, {"": x})]


def test_inertia_of_zero_stays_impossible_without_links():
    terms, zeros = (Inertia(), Viscous(), Coulomb()), np.zeros(5)
    model = Model.build(terms, [0.0, VISCOUS, DRY])
    x = Samples(zeros, zeros, np.linspace(-1, 1, 5), zeros)
    assert "negative_inertia" in [gate.name for gate in find_violations(model, {"": x})]
    with pytest.raises(ModelError, match="above zero"):
        Model.from_json(model.json())
