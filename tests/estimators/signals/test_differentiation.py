"""Noise of differentiated signals."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from estimators.signals.differentiation import (
    correlate_averages,
    estimate_encoder_noise,
    estimate_position_noise,
    estimate_white_noise,
    find_rounding,
)
from pendulum_env.recording import read_recording


@pytest.mark.parametrize("lag", [1, 3, 6])
@pytest.mark.parametrize("difference", [[1.0], [1.0, -2.0, 1.0]])
def test_averages_of_white_noise_share_what_their_weights_overlap(lag, difference):
    weights = np.convolve(np.hanning(13)[1:-1], difference)
    noise = np.random.default_rng(1).standard_normal(200_000)
    averages = np.convolve(noise, weights, mode="valid")
    measured = np.corrcoef(averages[lag:], averages[:-lag])[0, 1]
    assert correlate_averages(weights, lag) == pytest.approx(measured, abs=0.02)


@given(seed=st.integers(0, 2**32 - 1), step=st.floats(1e-4, 0.05), pace=st.floats(0.5, 5.0))
@example(seed=50418126, step=0.005751809919273846, pace=3.75)  # rests in half of the samples, and moves by two steps
def test_the_step_that_a_smooth_signal_was_rounded_to_is_found(seed, step, pace):
    phase, time = np.random.default_rng(seed).uniform(0, 2 * np.pi, 2), np.arange(0, 10, 1e-3)
    signal = np.sin(pace * time + phase[0]) + 0.3 * np.sin(11.0 * time + phase[1])
    assert find_rounding(step * np.rint(signal / step)) == pytest.approx(step, rel=1e-6)


@given(seed=st.integers(0, 2**32 - 1), least=st.floats(0.02, 1.0))
def test_a_command_that_is_held_at_some_values_was_not_rounded_to_their_least_difference(seed, least):
    rng, held = np.random.default_rng(seed), np.repeat(np.arange(25), 200)
    seven = least * rng.permutation(np.arange(25) % 7)
    two, three = (least * rng.choice(levels, 25) for levels in ((-1.0, 1.0), (-1.0, 0.0, 1.0)))
    for values in (rng.uniform(-5, 5, 25), two, three, seven):
        assert find_rounding(values[held]) == estimate_white_noise(values[held]) == 0.0


def test_a_position_that_rests_for_most_of_the_time_is_rounded_nevertheless():
    time, step = np.arange(0, 10, 5e-3), 1e-3
    position = step * np.rint(0.05 * np.clip(np.sin(2.0 * time) - 0.8, 0, None) / 0.2 / step)  # at rest for 80 %
    assert np.mean(np.diff(position) == 0) > 0.75
    assert estimate_position_noise(position) >= step / np.sqrt(12)


def test_rows_per_encoder_edge_have_the_noise_of_its_step_and_not_of_their_interpolation():
    time, step = np.arange(0, 20, 1e-3), 1.5e-3
    position = step * np.floor(0.8 * np.sin(1.3 * time) / step)
    edges = np.flatnonzero(np.diff(position, prepend=-1.0))
    log = {"time": time[edges], "position": position[edges], "torque": np.cos(1.3 * time[edges])}
    with pytest.warns(match="filled in by interpolation|left out"):
        read = read_recording(log, columns={"position": "position:rad"})
    assert estimate_position_noise(read.position) < 0.8 * step / np.sqrt(12) < estimate_encoder_noise(read)
