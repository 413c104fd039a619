"""Position, velocity and parameters in one state: right where others differentiate in vain, and as sure as it says."""

import pickle
from dataclasses import replace
from functools import cache

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.online import Estimates, JointState, OnlineEstimator
from estimators.schemes import six
from estimators.schemes.six import SCHEMES
from estimators.signals.measurements import compute_encoder_noise
from estimators.wrappers import EstimateParameters, EstimateParametersVector
from pendulum_env.physics import BASE, effect
from pendulum_env.registration import PENDULUM
from tests.cases import TRUTH
from tests.feeding import feed, play_two_tones

PERIOD = 0.02  # [s]


@cache
def slow_runs(n: int = 12, **plant: float) -> list:
    experiment = {"rate": 1 / PERIOD, "seconds": 16.0, "counts": 65_536, "torque_noise": 0.05}
    effects = {"payload_change": plant} if plant else {}
    return simulate([(Plant(effects=effects), Experiment(seed=seed, **experiment)) for seed in range(n)])


def estimator(n: int, **options) -> OnlineEstimator:
    schemes = [six.scheme("dynamic"), six.scheme("energy"), JointState()]
    noise = compute_encoder_noise(65_536)
    return OnlineEstimator(1 / PERIOD, **{"schemes": schemes, "batch": n, "position_noise": noise} | options)


@cache
def slowly() -> tuple[OnlineEstimator, list[Estimates]]:
    one = estimator(12)
    return one, feed(one, slow_runs())


@pytest.mark.slow
def test_at_50_hz_it_is_more_accurate_and_its_intervals_hold_the_truth():
    """An independent integrator, twelve runs: 95 % intervals hold 88 to 100 % of 48 parameters."""
    one, course = slowly()
    now = course[-1]
    learnt = [np.exp(filter.log_variance / 2) for filter in one._joint.filters]
    assert np.mean(learnt) == pytest.approx(0.05, rel=0.25)  # by how much the torque that acts is off the measured one
    errors = now.theta - TRUTH
    std = np.sqrt(np.einsum("bsii->bsi", now.covariance))
    dynamic, _, joint = np.sqrt(np.mean((errors / TRUTH) ** 2, axis=(0, 2)))
    assert joint < 0.65 * dynamic and joint < 0.004
    assert 0.88 <= np.mean(np.abs(errors[:, 2]) < 1.96 * std[:, 2]) <= 1.0
    assert 0.5 < np.sqrt(np.mean((errors[:, 2] / std[:, 2]) ** 2)) < 1.5


@pytest.mark.slow
def test_it_borrows_a_regression_until_that_knows_enough_and_then_waits_for_nothing():
    _, course = slowly()
    running = np.array([now.usable[0, 2] for now in course])
    begin = int(np.argmax(running))
    assert 1.0 <= begin * PERIOD < 8.0 and running[begin:].all() and not running[:begin].any()
    assert not course[begin - 1].error[0, 2] and course[-1].error[0, 2]  # of the newest sample
    assert course[-1].index[0] < len(course) - 5  # where the others are still smoothing
    early = course[begin - 1]
    for now in (early, course[begin]):  # before and at the start
        assert (now.theta[0, 2] != 0).all() and np.isfinite(now.covariance[0, 2]).all()


@pytest.mark.slow
def test_a_payload_picked_up_in_mid_run_is_tracked():
    runs = slow_runs(3, pay_t=8.0, pay_I=0.03, pay_mgl=0.6)
    theta = feed(estimator(3, schemes=[JointState()], forgetting=0.98), runs)[-1].theta[:, 0]
    np.testing.assert_allclose(np.median(theta, axis=0)[:2], [0.12, 2.6], rtol=0.04)


def test_a_joint_that_sticks_tells_nothing_and_costs_nothing():
    """Two seconds of motion, then ten of torque that dry friction balances: theta and P stay, and go on afterwards."""
    time = np.arange(0, 16, PERIOD)
    command = np.where((time < 4) | (time > 14), 3 * np.sin(12.07 * time) + 3 * np.sin(2.25 * time), 0.3)
    runs = simulate([(Plant(), Experiment(rate=1 / PERIOD, seconds=16.0, counts=65_536, torque_noise=0.05))], [command])
    course = feed(estimator(1, schemes=[JointState()]), runs)
    assert course[int(3.9 / PERIOD)].usable[0, 0]
    before, after = (np.sqrt(np.diag(course[int(t / PERIOD)].P[0, 0])) for t in (7.0, 13.5))
    np.testing.assert_allclose(after, before, rtol=0.3)
    theta, std = course[-1].theta[0, 0], np.sqrt(np.diag(course[-1].covariance[0, 0]))
    assert (np.abs(theta - TRUTH) < 4 * std).all() and (std < 0.05 * TRUTH).all()


def test_a_copy_goes_on_alike_and_lost_samples_keep_the_parameters():
    runs = slow_runs()[:1]
    one = estimator(1, schemes=[JointState()])
    before = feed(one, runs, 0, 500)[-1]
    np.testing.assert_array_equal(replace(before).covariance, before.covariance)
    copy = pickle.loads(pickle.dumps(one))
    np.testing.assert_array_equal(feed(one, runs, 500, 520)[-1].theta, feed(copy, runs, 500, 520)[-1].theta)
    copy.take(np.full(1, 10.4), np.full(1, np.nan), np.zeros(1))
    after = feed(copy, runs, 521, 800)[-1]
    np.testing.assert_allclose(after.theta, before.theta, rtol=0.03)
    assert after.usable[0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("id", ["actuator_lag", "dead_time"])
def test_terms_with_memory_and_delay_are_those_of_the_model(id):
    hidden = {"actuator_lag": {"lag_T": 0.03}, "dead_time": {"dead_n": 2.0}}[id]
    term = {"actuator_lag": effect("actuator_lag")(0.03), "dead_time": effect("dead_time")(2 * PERIOD)}[id]
    experiment = Experiment(rate=1 / PERIOD, seconds=16.0, counts=65_536, torque_noise=0.05)
    runs = simulate([(Plant(effects={id: hidden}), experiment)])
    right, wrong = (
        feed(estimator(1, terms=terms, schemes=[JointState()]), runs)[-1] for terms in ((*BASE, term), BASE)
    )
    np.testing.assert_allclose(right.theta[0, 0], TRUTH, rtol=0.04)
    assert np.abs(wrong.theta[0, 0] / TRUTH - 1).max() > 0.1


def test_it_runs_beside_the_others_in_a_wrapper():
    env = EstimateParameters(gym.make(PENDULUM, rate=200), schemes=["joint_state_ukf", "energy"], in_observation=True)
    observation, info = env.reset(seed=0)
    assert list(info["estimates"]) == ["energy", "joint_state_ukf"] and observation.shape == (3 + 2 * 2 * 4,)
    *_, info = play_two_tones(env, 900)
    assert info["estimates"]["joint_state_ukf"]["theta"] == pytest.approx(info["plant"], rel=0.02)
    several = EstimateParametersVector(gym.make_vec(PENDULUM, num_envs=2, rate=200), schemes=[*SCHEMES, JointState()])
    _, info = several.reset(seed=0)
    assert info["estimates"]["joint_state_ukf"]["covariance"].shape == (2, 4, 4)
