"""The recursion by filterpy's Kalman filter: the same theta and P as ours, wherever they mean the same."""

import pickle
from functools import cache

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.online import OnlineEstimator
from estimators.online.estimator import RECURSIONS
from tests.feeding import fed

CASES = {  # options, and how close
    "all": ({}, 1e-8),
    "wandering": ({"random_walk": 0.05}, 1e-8),
    "wandering each": ({"random_walk": [0.005, 0.1, 0.0, 0.05]}, 1e-8),
    "forgetting": ({"forgetting": 0.998, "prior": 1e9}, 1e-6),  # where ours is still far from returning to P(0)
}


@cache
def plant_run():
    (run,) = simulate([(Plant(), Experiment(rate=500.0, seconds=2.5, seed=1))])
    return run


@pytest.mark.parametrize("case", CASES)
def test_theta_and_covariances_are_those_of_ours(case):
    options, close = CASES[case]
    both = [fed(OnlineEstimator(500.0, recursion=name, **options), plant_run()) for name in RECURSIONS]
    for k in (700, 1249):
        ours, theirs = (estimates[k] for estimates in both)
        np.testing.assert_allclose(theirs.theta, ours.theta, rtol=close)
        np.testing.assert_allclose(theirs.error, ours.error, rtol=100 * close, atol=close)
        for mine, other in ((ours.P, theirs.P), (ours.covariance, theirs.covariance)):
            scale = np.sqrt(np.einsum("bsii->bsi", mine))
            scale = scale[..., None] * scale[..., None, :]
            np.testing.assert_allclose(other / scale, mine / scale, atol=close)


def test_what_was_handed_out_stays_and_a_copy_goes_on_alike():
    estimator = OnlineEstimator(500.0, recursion="KalmanFilter")
    before = fed(estimator, plant_run(), last=600)[-1]
    theta, P = before.theta.copy(), before.spread().copy()
    copy = pickle.loads(pickle.dumps(estimator))
    one, other = (fed(each, plant_run(), 600, 900)[-1].theta for each in (estimator, copy))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(before.theta, theta)
    np.testing.assert_array_equal(before.spread(), P)
    estimator.reset()
    assert (fed(estimator, plant_run(), last=1)[-1].theta == 0).all()
