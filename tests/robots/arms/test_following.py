"""A simulated arm that follows a designed motion: against its closed form, integrated by SciPy, and what is found."""

import numpy as np
import pytest

from benchmarks.two_link import TwoLink
from robots.arms.env import PlanarArm
from robots.arms.excitation import design_excitation
from robots.arms.following import Follow, follow
from robots.arms.plane import find_planar_links

ARM = TwoLink()


@pytest.fixture(scope="module")
def motion(body):
    return design_excitation(body, rng=np.random.default_rng(0))


def arm(body, **arguments):
    return PlanarArm(find_planar_links(body), joints=body.joints, velocity="ideal", **arguments)


def test_a_recorded_arm_is_the_textbooks_under_the_same_torque(body, motion):
    recording = follow(arm(body, counts=0), motion, 2000, rng=np.random.default_rng(0))
    time, held = recording.time, recording.torque
    middles = time + 0.5e-3  # of what is held; between them it hardly changes

    def torque(at):
        return np.array([np.interp(at, middles, held[:, k]) for k in range(2)])

    (q,), (v,), _ = motion(np.zeros(1))
    told, _ = ARM.simulate(torque, time, tuple(q), tuple(v), rtol=1e-6)
    assert np.ptp(told, axis=0).min() > 0.5
    assert np.abs(recording.position - told).max() < 2e-3


def test_torque_limits_are_kept_whatever_the_error(body, motion):
    controller = Follow(motion, np.array([2.0, 0.5]))
    asked = controller.torque({"time": 0.0, "position": np.array([3.0, -3.0]), "velocity": np.zeros(2)})
    assert (np.abs(asked) == [2.0, 0.5]).all()
