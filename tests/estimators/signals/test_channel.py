"""The torque channel: what acts is what was logged, moved and unfiltered."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from estimators.signals.channel import Channel
from pendulum_env.physics import Samples

PERIOD = 0.002  # [s]
TORQUE = np.random.default_rng(0).standard_normal(400)


@given(st.floats(1e-4, 0.05))
def test_a_filter_of_the_log_is_undone(time_constant):
    keep = np.exp(-PERIOD / time_constant)
    logged = lfilter([1 - keep], [1, -keep], TORQUE, zi=[keep * TORQUE[0]])[0]
    np.testing.assert_allclose(Channel(lag=time_constant).hold_torque(logged, PERIOD), TORQUE, atol=1e-9)


@given(st.floats(0.0, 0.05))
def test_torque_that_rises_evenly_is_moved_by_the_delay(delay):
    ramp = np.arange(400.0)
    moved = Channel(delay).hold_torque(ramp, PERIOD)[100:300]
    np.testing.assert_allclose(moved, ramp[100:300] + delay / PERIOD, atol=1e-9)


@given(st.integers(0, 20), st.floats(0.0, 0.4) | st.floats(0.6, 0.99))
def test_a_log_that_is_late_by_a_share_of_a_sample_is_undone(whole, share):
    late = np.concatenate([np.full(whole + 1, TORQUE[0]), TORQUE])
    logged = (1 - share) * late[1 : 1 + len(TORQUE)] + share * late[: len(TORQUE)]
    acting = Channel((whole + share) * PERIOD).hold_torque(logged, PERIOD)
    np.testing.assert_allclose(acting[50:300], TORQUE[50:300], atol=1e-6)


@pytest.mark.parametrize("channel", [Channel(0.0071), Channel(-0.0071), Channel(lag=0.01), Channel(lag=-0.01)])
def test_windows_see_slow_torque_at_the_same_time(channel):
    """Of a ramp, the average over both sides of a sample is that of the two periods beside it, moved alike."""
    ramp = np.arange(400.0)
    seen = channel.trace(Samples(ramp, ramp, ramp, ramp), ramp, PERIOD)[0][100:300]
    shift = channel.delay / PERIOD
    shift += np.sign(channel.lag) * (1 / np.expm1(PERIOD / channel.lag) if channel.lag > 0 else -channel.lag / PERIOD)
    np.testing.assert_allclose(seen, ramp[100:300] - 0.5 + shift, atol=1e-6)


@pytest.mark.parametrize("steps", [10, 20])  # of a sample, a turn of the torque
def test_torque_that_was_sampled_moves_a_mass_through_the_same_places_once_it_is_held(steps):
    pace, period = 2 * np.pi, 1.0 / steps
    time = period * np.arange(8 * steps)
    held = Channel(period / 2, is_sampled=True).hold_torque(np.cos(pace * time), period)
    second_difference = 0.5 * (held[1:] + held[:-1]) * period**2  # of places under a held force
    truth = np.diff(-np.cos(pace * time) / pace**2, 2)
    inside = slice(2, -2)
    most = (pace * period) ** 4 / 25 * truth.max()
    np.testing.assert_allclose(second_difference[:-1][inside], truth[inside], atol=most)
