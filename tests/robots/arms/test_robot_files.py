"""Robot files as they come: links with inertias that no body has, and joints that a recording leaves alone."""

import re

import numpy as np
import pytest

from robots.arms import find_logged_joints, find_planar_links, read_arm_recording, read_body
from robots.arms.body import BodyError
from robots.arms.design_env import ArmExcitationDesignVector
from robots.arms.env import SpatialArm
from robots.arms.excitation import design_excitation
from robots.arms.robot import find_movable_joints
from tests import robot_files
from tests.robot_files import ELBOW, PARALLEL, SHOULDER, urdf
from tests.robots.arms.test_body import written

TWO = (SHOULDER, ELBOW)


def spoil(text: str) -> str:
    """Give the shoulder's link an inertia that breaks the triangle inequality, and take the elbow's inertia away."""
    text = text.replace('iyy="0.031"', 'iyy="0.31"')
    return re.sub(r'(<link name="elbow_link">)<inertial>.*?</inertial>', r"\1", text)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Two joints and a gripper that is held at zero, of which the log has no columns."""
    columns = robot_files.simulate(PARALLEL, {}, seconds=8.0)
    kept = {name: values for name, values in columns.items() if not name.endswith(("left", "right"))}
    robot_files.write(kept, path := tmp_path_factory.mktemp("log") / "run.csv")
    return path


def test_impossible_links_are_listed_at_once_and_leave_the_kinematics(tmp_path):
    good = read_body(written(tmp_path, urdf(TWO)))
    bad = read_body(written(tmp_path, spoil(urdf(TWO)), "bad.urdf"))
    assert good.impossible_links == {} and good.impossible_text == ""
    assert list(bad.impossible_links) == ["shoulder", "elbow"]
    assert "triangle" in bad.impossible_links["shoulder"] and "mass" in bad.impossible_links["elbow"]
    assert bad.names == good.names
    q, v, a = np.random.default_rng(0).uniform(-2, 2, (3, 20, 2))
    np.testing.assert_allclose(bad.torque(q, v, a), good.torque(q, v, a), atol=1e-12)


def test_an_inertia_that_is_not_positive_definite_is_named(tmp_path):
    body = read_body(written(tmp_path, urdf(TWO).replace('ixx="0.03"', 'ixx="-0.03"')))
    assert "positive definite" in body.impossible_links["shoulder"] and len(body.impossible_links) == 1


@pytest.mark.parametrize(
    "simulate",
    [SpatialArm, find_planar_links, design_excitation, lambda body: ArmExcitationDesignVector(1, robot=body)],
    ids=["mujoco", "pymunk", "excitation", "policy"],
)
def test_simulation_refuses_impossible_links_and_names_all(tmp_path, simulate):
    path = written(tmp_path, spoil(urdf(TWO)))
    with pytest.raises(BodyError, match=r"shoulder.*elbow"):
        simulate(str(path) if simulate.__name__ == "<lambda>" else read_body(path))


def test_a_frame_without_inertia_and_continuous_joints_are_no_fault(tmp_path):
    tool = (
        '<link name="tool0"/><joint name="flange" type="fixed"><parent link="elbow_link"/><child link="tool0"/>'
        '<origin xyz="0 0 -0.3"/></joint></robot>'
    )
    text = urdf(TWO).replace("</robot>", tool).replace('type="revolute"', 'type="continuous"')
    body = read_body(written(tmp_path, text))
    assert body.joints == ("shoulder", "elbow") and not body.impossible_links
    assert np.isinf(body.position_limits[1]).all()


def test_joints_without_columns_are_found_and_so_is_their_order(tmp_path, log):
    path = written(tmp_path, urdf(PARALLEL))
    assert find_movable_joints(path) == ("shoulder", "elbow", "left")
    assert find_logged_joints(log, ("shoulder", "elbow", "left")) == ("shoulder", "elbow")
    body = read_body(path, joints=("elbow", "shoulder"))
    assert body.joints == ("shoulder", "elbow")  # the robot's order
    columns = robot_files.simulate(TWO, {}, seconds=2.0)
    order = ["torque_elbow", "time", "position_elbow", "torque_shoulder", "position_shoulder"]
    robot_files.write({name: columns[name] for name in order}, tmp_path / "other.csv")
    assert find_logged_joints(tmp_path / "other.csv", body.joints) == body.joints
    read = read_arm_recording(tmp_path / "other.csv", body.joints)
    np.testing.assert_allclose(read.torque[:, 1], columns["torque_elbow"], atol=1e-9)


def test_a_position_alone_is_of_a_joint_that_is_held_unless_it_moves(tmp_path):
    time = np.arange(200) / 100
    columns = {"time": time, "position_a": np.sin(time), "torque_a": np.cos(time), "position_b": 0.3 + 0 * time}
    robot_files.write(columns, tmp_path / "still.csv")
    assert find_logged_joints(tmp_path / "still.csv", ["a", "b"]) == ("a",)
    robot_files.write(columns | {"position_b": np.sin(time)}, tmp_path / "moves.csv")
    assert find_logged_joints(tmp_path / "moves.csv", ["a", "b"]) == ("a", "b")  # reading asks for its torque
    numbered = {"time": time, "position_1": time, "torque_1": time, "position_2": time, "torque_2": time}
    robot_files.write(numbered, tmp_path / "numbers.csv")
    assert find_logged_joints(tmp_path / "numbers.csv", ["a", "b"]) == ("a", "b")
    named = {"torque_b": "torque_2", "position_b": "position_2"}
    assert find_logged_joints(tmp_path / "numbers.csv", ["a", "b"], named) == ("b",)
