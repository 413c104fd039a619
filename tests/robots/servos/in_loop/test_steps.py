"""Servos under steps of the goal: short motions and long rests, simulated by an integrator of the test."""

import math

import numpy as np
import pytest

from estimators import diagnose
from pendulum_env.recording import Recording, read_recording
from robots.servos import ServoDrive

INERTIA, GRAVITY, VISCOUS, COULOMB = 0.0116, 0.61, 0.047, 0.039  # kg m^2, N m, N m s/rad, N m
SUPPLY, GAIN, RESOLUTION = 12.0, 0.29, 2 * math.pi / 4096  # V, N m/V, rad


def follow_steps(seed: int, kp: float, stribeck: float, rate: float = 100.0, seconds: float = 20.0) -> Recording:
    """Simulate a duty controller at 1 kHz, dry friction as a set (Moreau) at 20 kHz, and goals set at each row."""
    rng, steps = np.random.default_rng(seed), 20
    torque, goal, change, q, v = 0.0, 0.0, 0.3, 0.0, 0.0
    h, times, positions, goals = 0.001 / steps, [], [], []
    for tick in range(int(seconds * 1000)):
        measured = round(q / RESOLUTION) * RESOLUTION
        if tick % (1000 // int(rate)) == 0:
            if tick / 1000 >= change:
                goal, change = float(rng.uniform(-1.4, 1.4)), change + 0.8
            times.append(tick / 1000)
            positions.append(measured)
            goals.append(goal)
        torque = min(max(kp * (goal - measured), -1.0), 1.0) * SUPPLY * GAIN
        for _ in range(steps):
            free = v + h * (torque - GRAVITY * math.sin(q + h * v / 2) - VISCOUS * v) / INERTIA
            dry = h * (COULOMB + stribeck * math.exp(-((v / 0.26) ** 2))) / INERTIA
            new = math.copysign(max(abs(free) - dry, 0.0), free)
            q, v = q + h * (v + new) / 2, new
    drive = ServoDrive(output="duty", kp=kp, limit=1.0, supply=SUPPLY, gain=GAIN, rate=1000.0)
    return read_recording(
        {"time": np.array(times), "position": np.array(positions), "goal": np.array(goals)},
        drive=drive,
        name=f"kp {kp:g}",
    )


@pytest.mark.slow
@pytest.mark.parametrize("stribeck", [0.0, 0.056])
def test_stribeck_friction_of_a_servo_under_steps_is_found(stribeck):
    logs = [follow_steps(k, kp, stribeck) for k, kp in enumerate((0.35, 0.7, 1.4))]
    found = diagnose(logs[:2], logs[2:], only=["stribeck", "cogging", "joint_flexibility"])
    assert found.selected == (("stribeck",) if stribeck else ())
    truth = {"inertia": INERTIA, "gravity": GRAVITY, "viscous": VISCOUS, "coulomb": COULOMB}
    truth |= {"stribeck": stribeck} if stribeck else {}
    for name, value in truth.items():
        estimate = found.model[name]
        assert abs(estimate.value - value) < max(3 * estimate.std, 0.02 * value), name
