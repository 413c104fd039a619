"""The recursion by filterpy's filters: the same theta and P as ours, wherever they mean the same."""

import pickle
from functools import cache

import filterpy.kalman
import gymnasium as gym
import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, SimulatedRecording, simulate
from estimators.online import Estimates, OnlineEstimator
from estimators.online.kalman import FADING, NAMES, OURS
from estimators.wrappers import EstimateParameters
from pendulum_env.registration import PENDULUM
from tests import slow

FILTERPY = NAMES[1:]
OPTIONS = {"all": {}, "wandering": {"random_walk": 0.05}, "anew": {"reset_every": 1.0}}


@cache
def paper_run() -> SimulatedRecording:
    return simulate([(Plant(), Experiment(rate=500.0, seconds=2.5, seed=1))])[0]


@cache
def estimates(name: str, case: str) -> list[Estimates]:
    run = paper_run()
    estimator = OnlineEstimator(500.0, recursion=name, **OPTIONS[case])
    held = np.r_[0.0, run.torque[:-1]]
    samples = zip(run.time, run.position, held, strict=True)
    return [estimator.take(np.full(1, t), np.full(1, q), np.full(1, u)) for t, q, u in samples]


@pytest.mark.parametrize("case", OPTIONS)
@pytest.mark.parametrize("name", slow.but_first(FILTERPY))
def test_theta_and_covariances_are_those_of_ours(name, case):
    """To 1e-8, for all six schemes, early and late; those that keep P itself lose digits where it starts anew."""
    close = 1e-4 if case == "anew" and name in FADING else 1e-8
    for k in (700, 1249):
        ours, theirs = (estimates(kind, case)[k] for kind in (OURS, name))
        np.testing.assert_allclose(theirs.theta, ours.theta, rtol=close)
        np.testing.assert_allclose(theirs.error, ours.error, rtol=100 * close, atol=close)
        for what in ("P", "covariance"):
            mine, other = getattr(ours, what), getattr(theirs, what)
            scale = np.sqrt(np.einsum("bsii->bsi", mine))
            scale = scale[..., None] * scale[..., None, :]
            np.testing.assert_allclose(other / scale, mine / scale, atol=close)


@pytest.mark.parametrize("name", FADING)
def test_fading_is_forgetting_where_information_is_fresh(name):
    """Ours returns to P(0) where nothing is told any more, filterpy's P grows without end: 1e-6 of P after 2 s."""
    run = paper_run()
    both = [OnlineEstimator(500.0, recursion=kind, forgetting=0.998, prior=1e9) for kind in (OURS, name)]
    held = np.r_[0.0, run.torque[:-1]]
    for t, q, u in zip(run.time, run.position, held, strict=True):
        ours, theirs = (one.take(np.full(1, t), np.full(1, q), np.full(1, u)) for one in both)
    np.testing.assert_allclose(theirs.theta, ours.theta, rtol=1e-8)
    scale = np.sqrt(np.einsum("bsii->bsi", ours.P))
    np.testing.assert_allclose(theirs.P / ours.P, 1.0, atol=1e-6)
    assert (scale > 0).all()


def test_what_was_handed_out_stays_and_a_copy_goes_on_alike():
    for name in FILTERPY:
        estimator = OnlineEstimator(500.0, schemes=OnlineEstimator(500.0).schemes[:2], recursion=name)
        rng = np.random.default_rng(0)
        path = np.cumsum(rng.normal(size=400)) * 0.01

        def feed(one, path=path, first=0, last=200):
            for k in range(first, last):
                now = one.take(np.full(1, k / 500), path[k : k + 1], np.sin(path[k : k + 1]))
            return now

        before = feed(estimator)
        theta, P = before.theta.copy(), before.spread().copy()
        copy = pickle.loads(pickle.dumps(estimator))
        np.testing.assert_array_equal(feed(estimator, first=200, last=400).theta, feed(copy, first=200, last=400).theta)
        np.testing.assert_array_equal(before.theta, theta)
        np.testing.assert_array_equal(before.spread(), P)
        estimator.reset()
        assert (estimator.standing().theta == 0).all()


def test_a_class_will_do_and_the_spec_holds_its_name():
    env = EstimateParameters(gym.make(PENDULUM), schemes="dynamic", recursion=filterpy.kalman.InformationFilter)
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    infos = []
    for one in (env, again):
        one.reset(seed=0)
        infos += [[one.step(np.array([np.sin(k / 30) * 4], dtype=np.float32)) for k in range(300)][-1][-1]]
    theta = [info["estimates"]["dynamic"]["theta"] for info in infos]
    np.testing.assert_array_equal(*theta)
    assert (theta[0] != 0).all()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"recursion": "KalmanFiltr"}, "unknown recursion 'KalmanFiltr': did you mean KalmanFilter"),
        ({"recursion": filterpy.kalman.EnsembleKalmanFilter}, "unknown recursion 'EnsembleKalmanFilter'"),
        ({"recursion": "InformationFilter", "forgetting": 0.99}, "InformationFilter has no fading memory"),
        ({"recursion": "KalmanFilter", "forgetting": 1.1}, "forgetting factor cannot be 1.1"),
    ],
)
def test_what_a_filter_cannot_do_is_said(options, text):
    with pytest.raises(ValueError, match=text):
        OnlineEstimator(500.0, **options)
