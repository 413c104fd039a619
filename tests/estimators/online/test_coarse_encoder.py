"""A coarse encoder: its resolution is learnt from the motion, and rest changes no estimate."""

from functools import cache

import numpy as np
import pytest

from estimators.online import OnlineEstimator
from tests.runge_kutta import stick_and_slip

TRUTH = np.array([0.05, 1.5, 0.12, 0.35])
RATE, COUNTS = 200.0, 16_384


@cache
def recorded(seconds: float, rest: float) -> np.ndarray:
    """Time, position and torque over the period before (3, N): motion under three sines, then rest with noise."""
    inertia, gravity, viscous, coulomb = TRUTH
    rng, time = np.random.default_rng(0), np.arange(round((seconds + rest) * RATE)) / RATE
    tones = ((2.2, 0.31, 0.0), (1.3, 0.83, 1.0), (0.7, 1.9, 2.0))
    torque = sum(size * np.sin(2 * np.pi * frequency * time + phase) for size, frequency, phase in tones)
    torque = np.where(time < seconds, torque, 0.0)
    position, *_ = stick_and_slip(
        lambda t, q, v, u: u - gravity * np.sin(q) - viscous * v, lambda *_: coulomb, inertia, torque, 1 / RATE
    )
    count = 2 * np.pi / COUNTS
    measured = count * np.rint(position[:-1] / count + 0.2 * rng.standard_normal(len(time)))
    torque = torque + 0.02 * rng.standard_normal(len(time)) * (time >= seconds)
    return np.array([time, measured, np.append(0.0, torque[:-1])])


def fed(estimator: OnlineEstimator, samples: np.ndarray):
    return [estimator.take(*(np.full(1, value) for value in sample)) for sample in samples.T]


def standard_errors(now) -> np.ndarray:
    return np.sqrt(np.einsum("bsii->bsi", now.covariance))[0]


@pytest.mark.parametrize("options", [{"forgetting": 0.999}, {}, {"random_walk": 0.01}], ids=str)
def test_rest_changes_no_estimate(options):
    """There is no information in it, so nothing is counted, and nothing forgotten."""
    estimates = fed(OnlineEstimator(RATE, **options), recorded(6.0, 20.0))
    stopped, rested = estimates[round(7.5 * RATE)], estimates[-1]
    np.testing.assert_allclose(rested.theta, stopped.theta, rtol=1e-12)
    if "random_walk" not in options:
        np.testing.assert_allclose(rested.covariance, stopped.covariance, rtol=0.2)  # of the last, unfinished cluster
