"""Errors under a policy: the estimator in the loop is the real one."""

from functools import partial

import numpy as np
import pytest

from agents.baselines import make_baseline
from agents.comparison import compute_information_ratio
from agents.evaluation import compute_cramer_rao_bound, evaluate_policy, find_settling_time


def test_time_from_which_errors_stay_within_a_bound():
    errors = np.array([[3.0, 0.5, 3.0, 3.0], [0.5, 0.5, 0.5, 3.0], [3.0, 0.5, 0.5, 3.0], [0.5, 0.5, 0.5, 3.0]])
    np.testing.assert_allclose(find_settling_time(errors, 1.0), [0.08, 0.02, 0.04, np.inf])


@pytest.fixture(scope="module")
def two_tone():
    """What the usual signal finds on six plants."""
    return evaluate_policy(partial(make_baseline, "two-tone", "peak"), "peak", 6, seed=3)


@pytest.mark.slow
def test_every_policy_meets_the_same_plants_and_the_estimator_finds_them(two_tone):
    first, names = two_tone, ("two-tone", "multisine-optimised")
    again, other = (evaluate_policy(partial(make_baseline, name, "peak"), "peak", 6, seed=3) for name in names)
    np.testing.assert_array_equal(first.errors, again.errors)
    assert first.errors[-1].max() < 0.005
    assert np.isfinite(first.close).all() and first.close.max() < 4.0
    assert (first.close[0] <= first.close[1]).all()
    assert np.abs(first.torque).max() <= 6.0 and np.abs(other.torque).max() == pytest.approx(6.0)
    assert compute_information_ratio(other.log_det[-1], first.log_det[-1]) > 1.3
    assert (np.diff(first.errors, axis=0).mean(axis=1) < 0).all()


@pytest.mark.slow
def test_no_estimate_beats_the_cramer_rao_bound_and_online_ones_come_near():
    outcome = evaluate_policy(partial(make_baseline, "two-tone", "peak"), "peak", 60, seed=5)
    ratio = np.sqrt(np.mean((outcome.errors / outcome.bound) ** 2, axis=1))
    assert (ratio > 0.8).all() and (ratio < 1.4).all()


def test_the_bound_is_that_of_least_squares_with_known_motion():
    """It falls with time, is the same in a mirror, and large where the arm only spins."""
    truth = np.array([[0.0895, 2.01, 0.3638, 0.9163]])
    time = np.arange(10_000) / 1000
    torque = 3 * np.sin(12.07 * time) + 3 * np.sin(2.25 * time)
    bound = compute_cramer_rao_bound(truth, torque[:, None])
    assert (np.diff(bound, axis=0) < 0).all()
    np.testing.assert_allclose(bound, compute_cramer_rao_bound(truth, -torque[:, None]), rtol=1e-6)  # in a mirror
    assert (compute_cramer_rao_bound(truth, np.full((10_000, 1), 6.0)) > 20 * bound).all()
    assert np.isinf(compute_cramer_rao_bound(truth, np.full((10_000, 1), 0.1))).all()  # it never moves


@pytest.mark.slow
def test_hidden_effects_leave_errors(two_tone):
    hidden = evaluate_policy(partial(make_baseline, "two-tone", "peak"), "peak", 6, seed=3, effects=("stribeck=0.4",))
    assert np.median(hidden.errors[-1]) > 5 * np.median(two_tone.errors[-1])
    assert np.isnan(hidden.bound).all()
