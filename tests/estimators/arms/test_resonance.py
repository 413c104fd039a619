"""A level arm of two links by equations and an integrator of its own: its elbow is elastic, only motors are seen."""

from functools import cache
from math import cos, exp, sin, tanh

import numpy as np
import pytest

from estimators import diagnose
from pendulum_env.arms.body import read_body
from pendulum_env.arms.joints import arm_base
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics.friction import Stribeck
from tests.runge_kutta import stepped

LENGTH, CENTER = 0.3, 0.2  # [m], of the first link, and along the second
MASS, FIRST, SECOND = 1.2, 0.08, 0.012  # [kg] of the second, [kg m^2] of the first about its joint, of the second
ROTORS = 0.05, 0.04  # [kg m^2]
VISCOUS, COULOMB = 0.3, 0.4  # [N m s/rad], [N m]
STIFFNESS, DAMPING = 150.0, 0.3  # [N m/rad], [N m s/rad]: 8 Hz if the motor stands still, damped by 0.05
COUNTS, STEPS = 2**20, 20  # of an encoder, and of the integrator between samples

URDF = f"""<robot name="level"><link name="ground"/>
<link name="upper"><inertial><origin xyz="0 0 0"/><mass value="1"/>
<inertia ixx="{FIRST}" iyy="{FIRST}" izz="{FIRST}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="{CENTER} 0 0"/><mass value="{MASS}"/>
<inertia ixx="{SECOND}" iyy="{SECOND}" izz="{SECOND}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="ground"/><child link="upper"/><axis xyz="0 0 1"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="{LENGTH} 0 0"/>
<axis xyz="0 0 1"/></joint></robot>"""


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    """The arm as its file has it."""
    path = tmp_path_factory.mktemp("robot") / "level.urdf"
    path.write_text(URDF)
    return read_body(path, rotors=True)


@cache
def run(is_elastic=True, stribeck=0.0, seconds=10.0):
    """A recording under a controller of the motors; a rigid elbow has a spring of which nothing shows."""
    rng = np.random.default_rng(3)
    frequency, phase = 2 * np.pi * np.arange(1, 7) / 7.3, rng.uniform(0, 2 * np.pi, (2, 6))
    size = rng.normal(size=(2, 6)) * [[0.3], [0.5]]
    stiffness, damping = (STIFFNESS, DAMPING) if is_elastic else (400 * STIFFNESS, 20 * DAMPING)
    both, own = LENGTH * MASS * CENTER, SECOND + MASS * CENTER**2
    whole = FIRST + MASS * LENGTH**2 + own + ROTORS[0]

    def friction(v):
        return VISCOUS * v + (COULOMB + stribeck * exp(-((v / 0.3) ** 2))) * tanh(v / 2e-3)

    def rate(t, q, motor, link, v, speed, w):
        through = stiffness * (motor - link) + damping * (speed - w)
        a, b, c = whole + 2 * both * cos(link), own + both * cos(link), own
        first = torque[0] - friction(v) + both * sin(link) * w * (2 * v + w)
        second = through - both * sin(link) * v * v
        det = a * c - b * b
        turning = (torque[1] - friction(speed) - through) / ROTORS[1]
        return v, speed, w, (c * first - b * second) / det, turning, (a * second - b * first) / det

    time, step = np.arange(0, seconds, 2e-3), 2e-3 / STEPS
    wave = frequency * time[:, None, None] + phase
    goals, speeds = np.sum(size * np.sin(wave), axis=2), np.sum(size * frequency * np.cos(wave), axis=2)
    x, path, torques = [*goals[0], goals[0, 1], 0.0, 0.0, 0.0], [], []
    for k, (goal, speed) in enumerate(zip(goals.tolist(), speeds.tolist(), strict=True)):
        gains = zip((150.0, 100.0), (10.0, 6.0), goal, speed, x[:2], (x[3], x[4]), strict=True)
        torque = [kp * (g - q) + kd * (s - v) for kp, kd, g, s, q, v in gains]
        path.append(x[:2])
        torques.append(torque)
        for n in range(STEPS):
            x = stepped(rate, k * 2e-3 + n * step, x, step)
    count = 2 * np.pi / COUNTS
    noise = 0.01 * rng.normal(size=(len(time), 2))
    return ArmRecording.of(
        "run", ("shoulder", "elbow"), time, np.round(np.array(path) / count) * count, torques + noise
    )


def test_an_elastic_elbow_is_named_by_its_resonance(level):
    found = diagnose(run(), (), arm_base(level), library={"stribeck": Stribeck})
    assert found.selected == ("joint_flexibility@elbow",) and "elbow" not in found.left
    assert found.headline.startswith("Missing: joint_flexibility@elbow")
    (between,) = found.transmissions
    assert found.laws == [between.text] and found.json()["transmissions"] == [between.json()]
    for own, true, share in ((between.stiffness, STIFFNESS, 0.005), (between.damping, DAMPING, 0.05)):
        assert own.value == pytest.approx(true, rel=share) and 0.0 < own.std < share * true
    before, after = (found.steps[k].errors["holdout"].joints for k in (0, -1))
    assert after["elbow"] < 0.2 * before["elbow"]
    assert found.model.estimates["rotor@elbow"].value == pytest.approx(ROTORS[1], rel=0.01)


def test_friction_of_a_rigid_elbow_is_no_flexibility_whether_it_may_be_named_or_not(level):
    stiff = run(is_elastic=False, stribeck=0.4)
    found = diagnose(stiff, (), arm_base(level), library={"stribeck": Stribeck})
    assert set(found.selected) == {"stribeck@elbow", "stribeck@shoulder"}
    unknown = diagnose(stiff, (), arm_base(level), library={})
    assert unknown.selected == () and "elbow" in unknown.left and unknown.transmissions == ()
