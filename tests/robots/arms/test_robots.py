"""Grippers, and a torso that slides: data from MuJoCo, which holds and ties joints by its own constraints."""

import numpy as np
import pytest

from estimators import compare, diagnose, identify
from estimators.diagnosis.completeness import Incomplete
from pendulum_env.physics.actuation import TorqueOffset
from pendulum_env.physics.friction import Stribeck
from pendulum_env.physics.potential import Cogging, Spring
from robots.arms import arm_base, read_arm_recording
from robots.arms.body import read_body
from robots.arms.excitation import design_excitation
from robots.arms.limits import DEFAULT_LIMITS
from tests.robot_files import ANGULAR, DRIVEN, PARALLEL, TORSO, simulate, urdf, write

ROBOTS = {"parallel": (PARALLEL, 0.02), "angular": (ANGULAR, 0.3), "driven": (DRIVEN, 0.0), "torso": (TORSO, 0.01)}
FEW = {"torque_offset": TorqueOffset, "spring": Spring, "cogging": Cogging}


def ran(folder, robot, seed=0, seconds=10.0, **hidden):
    """Body and recording, held where the gripper is."""
    joints, opened = ROBOTS[robot]
    held = {"left": opened} if robot != "driven" else {}
    (folder / "arm.urdf").write_text(urdf(joints))
    write(simulate(joints, held, seed, seconds, **hidden), folder / f"{robot}.csv")
    moves = [own.name for own in joints if own.sweep]
    still = [own.name for own in joints if not own.sweep]
    recording = read_arm_recording(folder / f"{robot}.csv", moves, held=still)
    at = {joint: float(np.mean(recording.still[joint])) for joint in held}
    assert at == pytest.approx(held, abs=1e-6)
    return read_body(folder / "arm.urdf", joints=moves, held=at), recording


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return {robot: ran(tmp_path_factory.mktemp(robot), robot) for robot in ROBOTS}


@pytest.mark.parametrize("robot", ROBOTS)
def test_friction_and_links_are_found_where_joints_are_held_follow_or_slide(runs, robot):
    body, recording = runs[robot]
    found = identify(recording, arm_base(body))
    model = found["filtered_dynamic"].model
    for own in (own for own in ROBOTS[robot][0] if own.sweep):
        assert model.estimates[f"viscous@{own.name}"].value == pytest.approx(own.viscous, rel=0.02)
        assert model.estimates[f"coulomb@{own.name}"].value == pytest.approx(own.coulomb, rel=0.01)
    std = np.array([model.estimates[name].std for name in body.names])
    assert np.all(np.abs(model.theta[: len(body.base)] - body.values) < 5 * std)
    assert np.all(std < 0.02 * np.abs(body.values).max())
    compared = compare(model, recording)
    assert max(compared.joint.errors.shares.values()) < 0.02
    assert not compared.regions and not any(isinstance(own, Incomplete) for own in found.findings)
    assert np.isnan(compared.joint.errors.torque_rms) == (len({*body.is_prismatic}) > 1)  # N and N m make no one number


def rubbing(velocity):
    return -20.0 * float(np.exp(-((velocity / 0.05) ** 2)) * np.tanh(velocity / 1e-3))


def test_what_is_hidden_at_a_joint_that_slides_is_named_there(tmp_path):
    body, recording = ran(tmp_path, "torso", seed=3, hidden={"torso": rubbing})
    found = diagnose(recording, (), arm_base(body), library={"stribeck": Stribeck, **FEW})
    assert found.selected == ("stribeck@torso",)
    assert found.model.estimates["stribeck@torso"].unit == "N"
    speed = found.model.estimates["stribeck.stribeck_velocity@torso"]
    assert speed.unit == "m/s" and speed.value == pytest.approx(0.05, rel=0.2)
    assert "cogging@torso" not in {candidate.effect for candidate in found.candidates}


def test_what_is_hidden_at_a_joint_that_others_follow_is_named_there(tmp_path):
    body, recording = ran(tmp_path, "driven", seed=3, hidden={"jaw": lambda velocity: -0.2})
    assert diagnose(recording, (), arm_base(body), library=FEW).selected == ("torque_offset@jaw",)


@pytest.mark.parametrize("robot", ["driven", "torso"])
def test_nothing_is_named_where_nothing_is_hidden(runs, robot):
    body, recording = runs[robot]
    assert diagnose(recording, (), arm_base(body), library=FEW).selected == ()


def test_a_motion_that_is_designed_keeps_a_torso_within_its_stroke(runs):
    body = runs["torso"][0]
    motion = design_excitation(body, 3.0, max_angle=1.0, max_speed=2.0, max_torque=60.0)
    q, v, a = motion(np.linspace(0, motion.seconds, 400))
    assert np.abs(q[:, 1:]).max() <= 1.0 + 1e-9 and np.abs(v[:, 0]).max() <= DEFAULT_LIMITS.linear_speed
    assert np.abs(body.torque(q, v, a) @ body.values)[:, 0].max() > 60.0  # what it carries weighs more
