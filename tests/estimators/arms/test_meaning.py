"""What a logged torque means, told by how much of the file's torques is in it."""

import re
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


def test_a_torque_that_is_a_joints_own_raises_no_question(plain, six):
    assert meaning([plain], six) == []
    found = {own.joint: own for own in shares([plain], six)}
    assert np.isnan(found["base"].weight)  # it turns about the vertical
    assert found["shoulder"].weight == pytest.approx(1.0, abs=0.02)


def test_a_driver_that_takes_gravity_off_is_noticed(plain, six):
    held = six.torque(plain.position, 0 * plain.position, 0 * plain.position) @ six.values
    light = replace(plain, torque=plain.torque - held)
    (text,) = meaning([light], six)
    assert re.match("no gravity in the torque of joint.* shoulder.* say --no-gravity$", text)
    assert len(six.weightless.base) < len(six.base)


def test_torques_before_a_gear_and_of_another_sign_are_noticed(plain, six):
    (text,) = meaning([column(plain, "shoulder", 1 / 80)], six)
    assert "torque of joint shoulder is about 0.01 times" in text and "before its gear" in text
    (text,) = meaning([column(plain, "shoulder", -1.0)], six)
    assert "joint shoulder seems to carry the weight of its links upwards" in text
