"""Filters of series."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter, savgol_filter

from pendulum_env.filters import filter_lag, filter_savitzky_golay, filter_shifted


@pytest.mark.parametrize("shape", [(300,), (300, 3)])
def test_lag_is_the_first_order_recursion(shape):
    series = np.random.default_rng(0).standard_normal(shape)
    np.testing.assert_allclose(
        filter_lag(series, 0.9), lfilter([0.1], [1, -0.9], series, axis=0), rtol=1e-12, atol=1e-14
    )


def test_lag_goes_on_from_where_it_was():
    series = np.random.default_rng(1).standard_normal(300)
    whole = filter_lag(series, 0.7, 2.0)
    np.testing.assert_allclose(filter_lag(series[100:], 0.7, whole[99]), whole[100:], rtol=1e-12, atol=1e-14)
    assert filter_lag(series[:1], 0.7, 2.0) == pytest.approx(1.4 + 0.3 * series[0])


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("length", [5, 31, 99])
def test_savitzky_golay_is_scipys(length, derivative):
    series = np.cumsum(np.random.default_rng(2).standard_normal(100))
    wanted = savgol_filter(series, length, 3, deriv=derivative, delta=0.01)
    found = filter_savitzky_golay(series, length, 3, derivative, 0.01)
    np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


@given(st.integers(-30, 30), st.integers(1, 8), st.integers(2, 40))
def test_a_shifted_filter_repeats_the_ends(newest, count, length):
    series, weights = np.arange(1.0, length + 1) ** 2, np.arange(1.0, count + 1)
    expected = [
        sum(weights[j] * series[min(max(k + newest - j, 0), length - 1)] for j in range(count)) for k in range(length)
    ]
    np.testing.assert_allclose(filter_shifted(series, newest, weights), expected)
