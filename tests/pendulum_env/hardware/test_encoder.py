"""From counts and clocks that are late by turns to samples on time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.config import EncoderSettings
from pendulum_env.backends.hardware.encoder import DeviceClock, Encoder, Ticks, subtract_counts


@given(st.integers(-(2**40), 2**40), st.integers(-(2**31), 2**31 - 1))
def test_steps_are_found_however_the_counter_is_read(count, step):
    """Signed or unsigned, before and after it rolled over."""
    for low in (0, -(2**31)):
        old, new = ((value - low) % 2**32 + low for value in (count, count + step))
        assert subtract_counts(new, old) == step


def test_an_encoder_unwraps_from_where_zero_is():
    turn = 2 * math.pi

    def positions(counts, **settings):
        encoder = Encoder(EncoderSettings(counts=1000, **settings))
        for k, count in enumerate(counts):
            encoder.add_reading(float(k), count)
            yield encoder.position

    start = positions((2**31 - 250, 2**31, -(2**31) + 250))
    assert list(start) == pytest.approx([0.0, turn / 4, turn / 2])
    assert list(positions((750, -1750), sign=-1, zero=500)) == pytest.approx([-turn / 4, 2.25 * turn])


def test_velocity_is_taken_over_2_ms_and_a_jump_is_not_taken_in():
    encoder = Encoder(EncoderSettings(counts=1_000_000), max_speed=35.0)
    for k in range(20):
        moved = encoder.add_reading(0.5e-3 * k, round(1000 * k))
        assert (moved is None) == (k % 4 != 0 or k == 0)
    assert encoder.velocity == pytest.approx(2 * math.pi / 0.5)
    before = encoder.position
    with pytest.raises(DriveError, match=r"the encoder jumped by .* rad in 2\.5 ms: check its cable"):
        encoder.add_reading(10.5e-3, 100_000)
    assert encoder.position == before


def test_position_and_torque_are_referred_to_the_ticks():
    """A swinging arm under a changing torque, commanded and read late at random, at 1 kHz."""
    rng = np.random.default_rng(0)
    period, count = 1e-3, 2000

    def position(t):
        return np.sin(8.0 * t)

    ticks, found = Ticks(period, 0.0, 0.0), []
    torques = 3.0 * np.sin(2 * np.pi * np.arange(count) * period)
    acted = []  # when each command came to act
    for k in range(count):
        acted.append(k * period + rng.uniform(0.0, 0.4e-3))
        ticks.add_command(acted[-1], torques[k])
        late = (k + 1) * period + rng.exponential(0.2e-3)
        ticks.add_measurement(late, position(late))
        ticks.wait()
        found.append((ticks.position, ticks.torque()))
    at = period * np.arange(1, count + 1)
    assert np.abs(np.array(found)[:, 0] - position(at)).max() < 1e-6  # at the time of reading it would be 1e-2 off
    # the impulse up to any tick is that of the commands, each from when it acted
    edges = np.append(acted, np.inf)
    impulse = [(torques * np.clip(t - edges[:-1], 0.0, np.diff(np.minimum(edges, 1e9)))).sum() for t in at[::100]]
    assert np.cumsum(np.array(found)[:, 1] * period)[::100] == pytest.approx(impulse, abs=1e-9)


def test_a_loop_that_was_held_up_catches_up():
    """20 ms without a reading: the ticks between are interpolated, and the held torque counts for all of them."""
    ticks = Ticks(1e-3, 0.0, 0.0)
    for k in range(1, 51):
        now = k * 1e-3
        ticks.add_command(now - 1e-3, 1.0)
        ticks.add_measurement(now, 0.5 * 40.0 * now**2)
        ticks.wait()
        assert ticks.torque() == pytest.approx(1.0)
    now = 70e-3
    ticks.add_measurement(now, 0.5 * 40.0 * now**2)
    for k in range(51, 71):
        ticks.wait()
        assert ticks.position == pytest.approx(0.5 * 40.0 * (k * 1e-3) ** 2, abs=1e-9)
        assert ticks.torque() == pytest.approx(1.0)


def test_the_clock_of_a_drive_is_told_although_answers_are_late():
    """Some answers come far too late, and the counter of microseconds rolls over."""
    rng = np.random.default_rng(1)
    clock, errors = DeviceClock(), []
    asked = 1000.0
    for _ in range(5000):
        asked += 1e-3
        to, back = 50e-6 + rng.exponential(100e-6, 2)
        taken = asked + to
        micro = int(1e6 * (taken * (1 + 50e-6)) + 2**32 - 3_000_000) % 2**32  # 50 ppm fast
        errors.append(clock.convert_time(micro, asked, taken + back) - taken)
    errors = np.array(errors[500:])
    assert np.abs(errors).max() < 60e-6
    assert np.abs(np.diff(errors)).max() < 20e-6  # what is constant does not matter, what jumps does
    assert clock.delay == pytest.approx(50e-6, abs=60e-6)
