"""A slow axis whose friction falls with the speed: free-running simulation is unstable, and errs without a reason."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import diagnose
from tests.cases import make_recording

RATE, SECONDS = 125.0, 60.0
SPEEDS = np.array([0.025, 0.06, 0.15, 0.4, 1.0, 0.03, 0.1, 0.25])  # [rad/s]
TRUTH = {"inertia": 1.3, "viscous": 11.0, "coulomb": 6.0}
FEW = ["stribeck", "hard_stop", "spring", "payload_change", "torque_offset", "quadratic_drag"]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_stribeck_friction_of_a_slow_axis_leaves_nothing_unexplained(seed):
    plant = Plant(**TRUTH, gravity=0.0, effects={"stribeck": {"strib_d": 4.0, "strib_v": 0.09}})
    step = np.arange(round(RATE * SECONDS)) // round(2 * RATE)
    speed = SPEEDS[step % len(SPEEDS)] * (-1.0) ** (step // len(SPEEDS) + step)
    smooth = np.convolve(np.pad(speed, 12, "edge"), np.ones(25) / 25, "valid")
    loop = {"gains": (800.0, 60.0), "torque_limit": 100.0}
    experiment = Experiment(RATE, SECONDS, "pd_loop", seed=seed, counts=2**20, torque_noise=0.3, **loop)
    (run,) = simulate([(plant, experiment)], None, [np.cumsum(smooth) / RATE])
    found = diagnose(make_recording(run), fixed={"gravity": 0.0}, only=FEW)
    assert found.selected == ("stribeck",) and not found.unexplained
    for name, value in (TRUTH | {"stribeck": 4.0, "stribeck.stribeck_velocity": 0.09}).items():
        estimate = found.model.estimates[name]
        assert abs(estimate.value - value) < 4 * estimate.std, name
