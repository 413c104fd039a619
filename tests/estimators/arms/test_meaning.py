"""What a logged torque means, told by how much of the file's torques is in it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import six_joint
from estimators.arms.meaning import shares
from workbench.robot import meaning


@pytest.fixture(scope="module")
def plain():
    return six_joint.simulate(1, seconds=6.0)


def column(run, joint, factor, offset=0.0):
    """The recording with the torque of one joint changed."""
    k, torque = six_joint.JOINTS.index(joint), np.array(run.torque)
    torque[:, k] = factor * torque[:, k] + offset
    return replace(run, torque=torque)


def test_a_torque_that_is_a_joints_own_raises_no_question(plain):
    body = six_joint.body()
    assert meaning([plain], body) == []
    found = {own.joint: own for own in shares([plain], body)}
    assert np.isnan(found["base"].weight)  # it turns about the vertical
    assert found["shoulder"].weight == pytest.approx(1.0, abs=0.02)


def test_a_driver_that_takes_gravity_off_is_noticed(plain):
    body = six_joint.body()
    held = body.torque(plain.position, 0 * plain.position, 0 * plain.position) @ body.values
    light = replace(plain, torque=plain.torque - held)
    (text,) = meaning([light], body)
    assert (
        text.startswith("no gravity in the torque of joint")
        and "shoulder" in text
        and text.endswith("say --no-gravity")
    )
    assert len(body.weightless.base) < len(body.base)


def test_torques_before_a_gear_and_of_another_sign_are_noticed(plain):
    body = six_joint.body()
    (text,) = meaning([column(plain, "shoulder", 1 / 80)], body)
    assert "torque of joint shoulder is about 0.01 times" in text and "before its gear" in text
    (text,) = meaning([column(plain, "shoulder", -1.0)], body)
    assert "joint shoulder seems to carry the weight of its links upwards" in text
