"""A planar arm that is simulated from a robot's file: pymunk against Pinocchio's regressors, and what is refused."""

import re

import numpy as np
import pytest

from benchmarks import six_joint
from pendulum_env.plant import PAPER
from robots.arms.body import BodyError, read_body
from robots.arms.env import PlanarArm
from robots.arms.planar import Link
from robots.arms.plane import find_planar_links
from tests.options import options as options
from tests.robots.arms.test_body import written

BENT = (  # centres of mass beside the lines, and lines that do not hang down where the joints are at zero
    Link(1.2, 0.45, 0.2, 0.02, 0.1, 0.2, center_offset=0.03, angle=0.4),
    Link(0.8, 0.35, 0.15, 0.008, 0.3, 0.4, center_offset=-0.02, angle=-1.9),
)


def test_links_come_back_from_their_file(tmp_path):
    first, last = find_planar_links(read_body(written(tmp_path, PlanarArm(BENT).urdf)))
    assert [first.length, first.center, first.center_offset, first.angle] == pytest.approx([0.45, 0.2, 0.03, 0.4])
    assert [first.viscous, first.coulomb, last.viscous, last.coulomb] == [0.1, 0.2, 0.3, 0.4]
    assert (last.mass, last.inertia) == pytest.approx((0.8, 0.008))
    text = PlanarArm(BENT).urdf.replace('<dynamics damping="0.1" friction="0.2"/>', "")  # then it has the paper's
    assert find_planar_links(read_body(written(tmp_path, text)))[0].coulomb == PAPER["coulomb"]


def test_a_bent_arm_moves_as_its_file_says(tmp_path):
    """Without friction, torque that Pinocchio's regressor asks for along the simulated motion is what was applied."""
    free = [Link(k.mass, k.length, k.center, k.inertia, 0.0, 0.0, k.center_offset, k.angle) for k in BENT]
    arm = PlanarArm(free, counts=0, velocity="ideal", rate=2000.0)
    body = read_body(written(tmp_path, arm.urdf))
    _, info = arm.reset(options={"position": [0.7, -1.2], "velocity": [1.5, -2.0]})
    applied, measured = np.array([0.6, -0.2]), []
    for _ in range(1000):
        measured.append((info["position"], info["velocity"]))
        info = arm.step(applied)[4]
    q, v = np.moveaxis(np.array(measured), 1, 0)
    a = np.gradient(v, 1 / arm.rate, axis=0)
    asked = (body.torque(q, v, a) @ body.values)[5:-5]
    assert np.ptp(q, axis=0).min() > 0.5
    assert v[1] == pytest.approx([1.5, -2.0], abs=0.05)  # as it was started
    assert np.abs(asked - applied).max() < 0.01  # of up to 8 N m of gravity


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: text.replace("0 -1 0", "1 0 0", 1), "joint 'elbow' does not turn in a vertical plane"),
        (lambda text: text.replace("0 -1 0", "0 0 1"), "joint 'shoulder' does not turn in a vertical plane"),
        (lambda text: text.replace('parent link="link1"', 'parent link="base"'), "branches"),
        (lambda text: re.sub(r'(link2"/><origin xyz=)"[^"]*"', r'\1"0 0 0"', text), "in one place"),
    ],
)
def test_what_the_simulator_cannot_be_is_refused(tmp_path, change, told):
    text = PlanarArm(BENT).urdf
    assert change(text) != text
    with pytest.raises(BodyError, match=told):
        find_planar_links(read_body(written(tmp_path, change(text))))
    with pytest.raises(BodyError, match="--backend mujoco"):  # nor can an arm in space
        find_planar_links(six_joint.body())
