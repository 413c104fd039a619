"""An arm of servos in MuJoCo follows its goals as the arm of the test does."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from pendulum_env.physics import Model, find_term
from pendulum_env.physics.base import Coulomb, Inertia, Viscous
from robots.arms.body import read_body
from robots.servo_arms.links import LinkTable, LinkTorque, make_link_torque, remove_weight
from robots.servo_arms.model import ServoArmModel
from tests.robots.servo_arms.simulated_arm import (
    DRY,
    JOINTS,
    KP,
    LENGTHS,
    MASSES,
    ROTOR,
    URDF,
    VISCOUS,
    ZERO,
    simulate,
)
from workbench.cli import main
from workbench.export import ExportError, Request, export

PER_VOLT = 0.5  # [N m/V]


def make_model(body, scale=1.0, drive=None, added=()):
    """Return the true model of the arm in units of `scale` N m."""
    names = tuple(name.replace("@", "_") for name in body.names)
    shares = np.vstack([np.zeros(len(names)), np.eye(len(names))])
    table = LinkTable(names, np.zeros(1), np.zeros((1, 4 * len(names))), shares)
    theta = np.array([ROTOR, *body.values, VISCOUS, DRY, *(value for _, value in added)]) / scale
    links = make_link_torque(LinkTorque, table)()
    terms = (Inertia(), links, Viscous(), Coulomb(), *(remove_weight(find_term(id))() for id, _ in added))
    servo = Model.build(terms, theta, 0.01 * np.abs(theta))
    servo = servo.convert_units(replace(servo.units(), torque_unit="V")) if scale != 1.0 else servo
    model = ServoArmModel.join(dict.fromkeys(JOINTS, servo), body)
    drive = drive or {"output": "torque", "kp": KP, "goal": "held", "reads": "exact", "encoder": "output"}
    return replace(model, log_format={"drive": drive})


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    file = tmp_path_factory.mktemp("arm") / "arm.urdf"
    file.write_text(URDF)
    return read_body(file)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    time, goals, angles = simulate(np.random.default_rng(3), 12.0)
    names = ["time", *(f"goal_{joint}" for joint in JOINTS), *(f"position_{joint}" for joint in JOINTS)]
    file = tmp_path_factory.mktemp("log") / "run.csv"
    columns = np.column_stack([time, goals - ZERO, angles - ZERO])
    np.savetxt(file, columns, delimiter=",", header=",".join(names), comments="", fmt="%.7g")
    return file


def test_check_plays_the_goals_in_mujoco(body, log, tmp_path, capsys):
    (tmp_path / "model.json").write_text(json.dumps(make_model(body).json()))
    (tmp_path / "arm.urdf").write_text(URDF)
    words = ["export", tmp_path / "model.json", "--to", "mjcf", "--robot", tmp_path / "arm.urdf", "--check", log]
    assert main([str(word) for word in [*words, "-o", tmp_path / "arm.xml"]]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    for at in JOINTS:
        own, theirs = (
            float(next(line for line in lines if line[:2] == [f"{at},", name])[-4]) for name in ("this", "MuJoCo")
        )
        assert theirs < 1.3 * own + 5e-4


def test_drive_and_joints_are_in_the_units_of_the_file(body):
    mujoco = pytest.importorskip("mujoco")
    drive = {"output": "voltage", "kp": KP / PER_VOLT, "kd": 0.1, "limit": 6.0, "goal": "held", "encoder": "output"}
    for model in (make_model(body), make_model(body, PER_VOLT, drive)):
        exported = export(model, "mjcf", Request(approximate=True))
        world = mujoco.MjModel.from_xml_string(exported.content)
        for k, at in enumerate(JOINTS):
            assert world.actuator(at).gainprm[0] == pytest.approx(KP, rel=0.03)
            assert world.dof_frictionloss[k] == pytest.approx(DRY, rel=0.03)
            assert world.dof_damping.reshape(3, -1)[k, 0] == pytest.approx(VISCOUS, rel=0.03)
            assert world.dof_armature[k] == pytest.approx(ROTOR, rel=0.1)
    limit = world.actuator("elbow").forcerange
    assert limit == pytest.approx([-6.0 * PER_VOLT, 6.0 * PER_VOLT], rel=0.03)
    assert any("N m by the masses" in note for note in exported.notes)


def test_drag_is_held_and_friction_under_load_is_that_of_a_typical_load(body):
    mujoco = pytest.importorskip("mujoco")
    model = make_model(body, added=[("load_dependent_friction", 0.2), ("quadratic_drag", 0.1)])
    exported = export(model, "mjcf", Request(approximate=True))
    world = mujoco.MjModel.from_xml_string(exported.content)
    weight = 9.81 * LENGTHS[0] * MASSES.sum()  # at most, of the first link alone at the lift
    assert DRY + 0.1 * weight < world.dof_frictionloss[0] < DRY + 0.4 * weight
    assert world.dof_frictionloss[0] > world.dof_frictionloss[2] + 0.02
    joint = ElementTree.fromstring(exported.content).find(".//joint[@name='lift']")
    assert float(joint.get("damping").split()[1]) == pytest.approx(0.1)
    assert any("at a load of" in note and "(at lift)" in note for note in exported.notes)


def test_parts_that_mujoco_lacks_are_named_with_their_joint(body):
    drive = {"output": "torque", "kp": KP, "delay": 0.02, "encoder": "output", "lift": {"ki": 1.0}}
    with pytest.raises(ExportError, match=r"(?s)integral.*at lift.*delay of 0.02 s.*at wrist"):
        export(make_model(body, drive=drive), "mjcf")
    with pytest.raises(ExportError, match="--drive"):
        export(replace(make_model(body), log_format={}), "mjcf")


@pytest.mark.parametrize("format", ["snippet", "feedforward"])
def test_joints_are_written_for_other_programs(body, format):
    text = export(make_model(body), format).content
    assert all(at in text for at in JOINTS)
