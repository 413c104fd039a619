"""Coarse encoders at a low rate, from motion in closed form."""

import numpy as np
import pytest

from estimators import identify
from estimators.signals.measurements import has_encoder_bias
from pendulum_env.recording import Recording

THETA = {"inertia": 0.09, "gravity": 2.0, "viscous": 0.36, "coulomb": 0.9}
RATE, SUBSTEPS = 100.0, 25


def record(counts: int, seed: int, seconds: float = 30.0) -> Recording:
    """Return a slow multisine and its torque by the law of the pendulum, the mean over each period."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.arange(1, 8) / 7.3
    a, phase = rng.normal(size=7) / np.arange(1, 8) ** 0.5, rng.uniform(0, 2 * np.pi, 7)
    a *= 1.6 / np.abs(a).sum()
    t = (np.arange(round(seconds * RATE) * SUBSTEPS)[:, None] + 0.5) / (RATE * SUBSTEPS)
    q, v, acceleration = (np.sum(a * w**n * np.sin(w * t + phase + n * np.pi / 2), axis=1) for n in range(3))
    torque = THETA["inertia"] * acceleration + THETA["gravity"] * np.sin(q) + THETA["viscous"] * v
    torque = np.mean((torque + THETA["coulomb"] * np.sign(v)).reshape(-1, SUBSTEPS), axis=1)
    time, step = np.arange(len(torque)) / RATE, 2 * np.pi / counts
    position = np.round(np.sum(a * np.sin(w * time[:, None] + phase), axis=1) / step) * step
    return Recording(time, position, torque + 0.01 * rng.standard_normal(len(time)), name=f"{counts} counts")


@pytest.mark.parametrize(("counts", "seed"), [(4096, 1), (4096, 2), (1024, 1)])
def test_a_coarse_encoder_leaves_no_bias(counts, seed):
    recording = record(counts, seed)
    assert has_encoder_bias(recording)
    for result in identify(recording, schemes=["dynamic", "filtered_dynamic", "filtered_power"]).values():
        for name, value in THETA.items():
            estimate = result.model[name]
            assert abs(estimate.value - value) < 4 * estimate.std, (result.scheme, name)


def test_a_fine_encoder_needs_no_correction():
    assert not has_encoder_bias(record(2**20, 0))
