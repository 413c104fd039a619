"""The comparison of policies: its statistics, and that the estimator in its loop is the real one."""

import numpy as np
import pytest

from agents.baselines import baseline
from agents.evaluation import improvement, information_ratio, interval, observe, stays_within


def test_time_from_which_errors_stay_within_a_bound():
    errors = np.array([[3.0, 0.5, 3.0, 3.0], [0.5, 0.5, 0.5, 3.0], [3.0, 0.5, 0.5, 3.0], [0.5, 0.5, 0.5, 3.0]])
    np.testing.assert_allclose(stays_within(errors, 1.0), [0.08, 0.02, 0.04, np.inf])


def test_ratios_and_their_intervals():
    rng = np.random.default_rng(0)
    base = rng.lognormal(0.0, 0.3, 400)
    policy = base / 2 * rng.lognormal(0.0, 0.05, 400)
    low, high = interval(improvement, policy, base)
    assert low < improvement(policy, base) < high
    assert improvement(policy, base) == pytest.approx(2.0, rel=0.1)
    assert information_ratio(np.full(3, 4 * np.log(2.5)), np.zeros(3)) == pytest.approx(2.5)
    assert np.isnan(improvement(np.full(4, np.inf), base))


def test_every_policy_meets_the_same_plants_and_the_estimator_finds_them():
    first, again, other = (
        observe(baseline(name, "peak", 1), "peak", 6, seed=3) for name in ("two-tone",) * 2 + ("prbs",)
    )
    np.testing.assert_array_equal(first.errors, again.errors)
    assert first.errors[-1].max() < 0.005
    assert np.isfinite(first.close).all() and first.close.max() < 3.0
    assert (first.peak <= 6.0).all() and (other.rms == pytest.approx(6.0))
    assert information_ratio(other.log_det, first.log_det) > 1.3
    assert (np.diff(first.errors, axis=0).mean(axis=1) < 0).all()


def test_hidden_effects_leave_errors():
    plain, hidden = (
        observe(baseline("two-tone", "peak", 1), "peak", 4, effects=effects) for effects in ((), ("stribeck=0.4",))
    )
    assert np.median(hidden.errors[-1]) > 5 * np.median(plain.errors[-1])
