"""Joints of an arm that are logged with another sign or zero than in the robot file."""

import numpy as np
import pytest

from benchmarks.retold import arms
from benchmarks.retold.machines import Sensors
from robots.arms import arm_base, read_body
from robots.arms.frames import Frame, find_wrong_frame
from robots.arms.reading import read_arm_recording

SENSORS = Sensors(500.0, 10.0, counts=65_536, noise=1e-3)


@pytest.fixture(scope="module")
def swings(tmp_path_factory):
    """Return a body, and a recording of the independent simulator."""
    rng = np.random.default_rng(7)
    arm, size = arms.draw_machine(rng)
    run = arms.run_arm(rng, arm, size, "multisine", SENSORS)
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(arm.urdf(), encoding="utf-8")
    body = read_body(path)
    table = {"time": run.time}
    for k, joint in enumerate(body.joints):
        table |= {f"position_{joint}": run.position[:, k], f"torque_{joint}": run.torque[:, k]}
    return body, table


def read(body, table, **columns):
    return read_arm_recording(table, body.joints, columns=columns or None)


def test_a_recording_in_the_frames_of_the_robot_file_is_right(swings):
    body, table = swings
    assert find_wrong_frame([read(body, table)], arm_base(body)) is None


@pytest.mark.parametrize("angle", [np.pi / 2, -0.6])
def test_a_wrong_zero_is_found_with_the_columns_that_correct_it(swings, angle):
    body, table = swings
    joint = body.joints[0]
    wrong = table | {f"position_{joint}": table[f"position_{joint}"] + angle}
    found = find_wrong_frame([read(body, wrong)], arm_base(body))
    assert found.joint == joint and found.angle.value == pytest.approx(angle, abs=np.radians(0.3))
    (remedy,) = found.remedies
    corrected = read(body, wrong, **remedy.columns)
    np.testing.assert_allclose(corrected.position, read(body, table).position, atol=np.radians(0.3))


def test_opposite_signs_are_found_with_the_columns_that_correct_them(swings):
    body, table = swings
    names = [f"{quantity}_{body.joints[1]}" for quantity in ("position", "torque")]
    wrong = table | {name: -table[name] for name in names}
    found = find_wrong_frame([read(body, wrong)], arm_base(body))
    (remedy,) = found.remedies
    corrected = read(body, wrong, **remedy.columns)
    signs = [np.sign(np.vdot(corrected.position[:, k], table[f"position_{at}"])) for k, at in enumerate(body.joints)]
    assert found.angle is None and signs in ([1, 1], [-1, -1])  # the mirror image of a planar arm is the same arm


def test_a_frame_corrects_sign_and_zero_of_one_joint(swings):
    body, table = swings
    arm = read(body, table)
    corrected = Frame(body.joints[1], 0.5, is_opposite=True).correct(arm)
    np.testing.assert_array_equal(corrected.position[:, 1], 0.5 - arm.position[:, 1])
    np.testing.assert_array_equal(corrected.torque[:, 1], -arm.torque[:, 1])
    np.testing.assert_array_equal(corrected.position[:, 0], arm.position[:, 0])
