"""Motor and link of one joint by equations and an integrator of their own."""

from dataclasses import replace
from functools import cache
from math import sin, tanh

import numpy as np
import pytest

from benchmarks.two_link import Multisine
from estimators.arms.transmission import find_transmissions
from pendulum_env.arms.recording import ArmRecording, read_arm_recording
from pendulum_env.recording import write_recording
from tests.runge_kutta import stepped

MOTOR, LINK, WEIGHT = 0.03, 0.06, 1.5  # [kg m^2], [kg m^2], [N m]
VISCOUS, COULOMB = 0.2, 0.4  # [N m s/rad], [N m]
STIFFNESS, DAMPING = 45.0, 0.25  # [N m/rad], [N m s/rad]
COUNTS = 2**17
STEPS = 30  # of the integrator between samples


@cache
def run(play=0.0, stiffness=STIFFNESS, seconds=8.0):
    time, torque = np.arange(0, seconds, 2e-3), Multisine.paper(1, (5.0, 2.5))
    step = 2e-3 / STEPS
    halves = step / 2 * np.arange(2 * STEPS * len(time) + 1)
    waves = zip(torque.amplitude[0], torque.frequency[0], torque.phase[0], strict=True)
    driven = sum(a * np.sin(w * halves + phase) for a, w, phase in waves).tolist()

    def rate(t, q, link, v, w):
        off = q - link
        stretch = off - min(max(off, -play), play)
        through = stiffness * stretch + DAMPING * (v - w) * (stretch != 0)
        friction = VISCOUS * v + COULOMB * tanh(v / 2e-3)
        pushed = driven[round(2 * t / step)] - friction - through
        return v, w, pushed / MOTOR, (through - WEIGHT * sin(link)) / LINK

    x, path = [0.0] * 4, []
    for k in range(STEPS * len(time)):
        if k % STEPS == 0:
            path.append(x[:2])
        x = stepped(rate, k * step, x, step)
    step = 2 * np.pi / COUNTS
    q, link = np.round(np.array(path).T[:, :, None] / step) * step
    held = torque.held(time, 2e-3)[:, :1] + 0.01 * np.random.default_rng(0).normal(size=(len(time), 1))
    return ArmRecording("run", time, q, held, names=("hinge",), link_position=link)


@pytest.mark.parametrize("play", [0.0, 0.02])
def test_stiffness_and_play_follow_from_both_sides_of_a_joint(play, tmp_path):
    write_recording(run(play), tmp_path / "run.csv")
    recording = read_arm_recording(tmp_path / "run.csv", ("hinge",))
    (found,) = find_transmissions([recording])
    assert found.stiffness is not None and found.damping is not None
    assert found.stiffness.value == pytest.approx(STIFFNESS, rel=0.02)
    assert found.damping.value == pytest.approx(DAMPING, rel=0.15)
    assert (found.play is not None) == bool(play)
    assert found.text.startswith("backlash@hinge" if play else "joint_flexibility@hinge")
    if found.play is not None:
        assert found.play.value == pytest.approx(play, rel=0.03)


def test_encoders_that_disagree_by_the_angle_are_no_spring():
    """A link's encoder off its axis by a milliradian, behind a rigid joint."""
    recording = run(stiffness=2e5)
    assert recording.link_position is not None
    off = 1e-3 * np.sin(recording.position + 0.3) + 5e-4 * recording.position
    (found,) = find_transmissions([replace(recording, link_position=recording.position - off)])
    assert found.stiffness is None
    (found,) = find_transmissions([replace(recording, link_position=recording.position)])
    assert found.stiffness is None


def test_a_joint_that_rests_takes_nothing_from_others():
    moves = run()
    assert moves.link_position is not None
    still = np.repeat(moves.position[:1], len(moves), axis=0)
    rests = replace(moves, position=still, link_position=still)
    (found,), (alone,) = find_transmissions([rests, moves]), find_transmissions([moves])
    assert found.stiffness is not None and alone.stiffness is not None
    assert found.stiffness.value == pytest.approx(alone.stiffness.value, rel=1e-6)
    (found,) = find_transmissions([rests])
    assert found.stiffness is None and "hinge is hardly ever clear of stick" in found.text


def test_a_stiff_joint_is_said_to_be_as_stiff_as_the_encoders_tell():
    recording = run(stiffness=2e5)
    (found,) = find_transmissions([recording])
    assert found.stiffness is None and "as stiff as its encoders can tell" in found.text
    assert find_transmissions([replace(recording, link_position=None)]) == ()
