"""Trends of parameters: known drifts and jumps, and none where nothing changes."""

import numpy as np
import pytest

from estimators.trends import MIN_ESTIMATES, fit_trend

WEEKS = np.arange(16.0)
STD = np.full(16, 0.004)


def estimates(seed: int, scatter: float = 0.004) -> np.ndarray:
    """A parameter that stays the same."""
    return 0.9 + np.random.default_rng(seed).normal(0.0, scatter, len(WEEKS))


@pytest.mark.parametrize("slope", [0.005, -0.005])
def test_a_drift_is_recovered_with_its_interval(slope):
    found = fit_trend(WEEKS, estimates(1) + slope * WEEKS, STD)
    assert found.jump is None and found.p_value < 1e-6
    assert found.interval[0] < slope < found.interval[1]
    assert found.drift == pytest.approx(slope, rel=0.1)


@pytest.mark.parametrize("size", [0.03, -0.03])
def test_a_jump_is_recovered_with_its_place(size):
    found = fit_trend(WEEKS, estimates(2) + size * (WEEKS >= 10), STD)
    assert found.p_value < 1e-6 and found.jump.first == 10
    assert abs(found.jump.size - size) < 3 * found.jump.std < 0.01


def test_one_outlier_moves_a_drift_by_less_than_its_interval():
    value = estimates(4) + 0.005 * WEEKS
    value[15] += 1.0
    assert fit_trend(WEEKS, value, STD).drift == pytest.approx(0.005, rel=0.2)


@pytest.mark.parametrize("scatter", [0.0, 0.05])
def test_unequal_standard_errors_make_no_trend(scatter):
    p_values = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        std = 10 ** rng.uniform(-3, -1, len(WEEKS))
        p_values.append(fit_trend(WEEKS, rng.normal(0.9, np.hypot(std, scatter)), std).p_value)
    assert np.mean(np.array(p_values) < 0.01) <= 0.03  # 2 expected of 200, at most


def test_a_drift_is_significant_only_if_its_interval_excludes_zero():
    drifts = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        std = 10 ** rng.uniform(-3, -1, len(WEEKS))
        found = fit_trend(WEEKS, rng.normal(0.9 + 0.003 * WEEKS, std), std)
        if found.jump is None and found.p_value < 0.001:
            drifts.append(found.interval)
    assert drifts and all(low > 0 for low, _ in drifts)


def test_few_recordings_and_recordings_of_one_day_show_nothing():
    few = MIN_ESTIMATES - 1
    assert np.isnan(fit_trend(WEEKS[:few], WEEKS[:few], STD[:few]).p_value)
    assert np.isnan(fit_trend(np.zeros(16), WEEKS, STD).drift)
