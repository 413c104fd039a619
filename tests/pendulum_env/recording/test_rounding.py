"""Columns that are rounded to significant digits, and positions that move by turns from sample to sample."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendulum_env.errors import ColumnError
from pendulum_env.recording import read_recording
from pendulum_env.recording.rounding import compute_steps, count_significant_digits, find_least_change

TIME = np.arange(400) / 100


def write(path, columns, digits="%.10g"):
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, fmt=digits, delimiter=",", header=",".join(columns), comments="")
    return path


@given(digits=st.integers(4, 8), size=st.floats(1e-3, 1e4), seed=st.integers(0, 2**32 - 1))
def test_significant_digits_are_counted_and_their_step_bounds_the_error(digits, size, seed):
    values = size * np.random.default_rng(seed).standard_normal(500)
    rounded = np.array([float(f"{value:.{digits}g}") for value in values])
    assert count_significant_digits(rounded) == digits
    assert np.all(np.abs(rounded - values) <= 0.5001 * compute_steps(rounded, digits))


@given(decimals=st.integers(0, 5), seed=st.integers(0, 2**32 - 1))
def test_decimals_counts_and_raw_floats_have_a_constant_step(decimals, seed):
    values = 300 * np.random.default_rng(seed).standard_normal(500)
    assert count_significant_digits(np.round(values, decimals)) is None
    assert count_significant_digits(values) is None


@pytest.mark.parametrize("speed", [0.3, 3.0, 24.0, 200.0])
def test_the_step_of_an_encoder_shows_at_any_speed(speed):
    """A joint at 24 rad/s turns by 62 counts in a sample: the least change is then no step."""
    time, step = np.arange(8000) / 1000, 2 * np.pi / 16_384
    turn = speed * time + 0.04 * np.sin(20 * time)
    assert find_least_change(step * np.round(turn / step)) == pytest.approx(step, rel=1e-6)
    analogue = turn + 1e-5 * np.random.default_rng(0).standard_normal(len(turn))
    assert find_least_change(analogue) < 1e-6
    edges = step * np.round(turn / step)[np.append(True, np.diff(np.round(turn / step)) != 0)]  # a row at each change
    assert find_least_change(edges) == pytest.approx(step, rel=1e-6)


def test_steps_of_a_position_are_in_radians(tmp_path):
    angle = 400 * np.sin(TIME)
    path = write(tmp_path / "log.csv", {"time": TIME, "angle_deg": angle, "torque": np.cos(TIME)}, "%.5g")
    steps = read_recording(path).position_steps
    largest = np.abs(angle) > 101
    np.testing.assert_allclose(steps[largest], np.radians(0.01), rtol=1e-6)
    assert np.all(steps[np.abs(angle) < 9.9] < np.radians(0.0011))


def test_a_fast_motor_moves_by_turns_from_sample_to_sample_and_a_glitch_is_refused(tmp_path):
    position = np.cumsum(9.0 * np.sin(TIME))  # up to 9 rad in a step
    columns = {"time": TIME, "position": position, "torque": np.cos(TIME)}
    read = read_recording(write(tmp_path / "fast.csv", columns), columns={"position": "position:rad"})
    assert np.abs(np.diff(read.position)).max() > 8
    columns["position"] = position + 8.0 * (TIME > 2)
    with pytest.raises(ColumnError, match="jumps by"):
        read_recording(write(tmp_path / "glitch.csv", columns), columns={"position": "position:rad"})


def test_a_position_that_is_omitted_is_the_integral_of_the_velocity(tmp_path):
    columns = {"time": TIME, "position": 50 * np.sin(TIME), "velocity": np.cos(TIME), "torque": np.cos(TIME)}
    read = read_recording(write(tmp_path / "log.csv", columns), columns={"position": "none"})
    np.testing.assert_allclose(read.position - read.position[0], np.sin(TIME), atol=1e-4)


def test_the_current_torque_is_a_torque_and_percent_keeps_its_unit(tmp_path):
    position, torque = np.sin(TIME), 100 * np.cos(TIME)
    read = read_recording(write(tmp_path / "now.csv", {"time": TIME, "angle": position, "current_torque": torque}))
    np.testing.assert_allclose(read.torque, torque, rtol=1e-6)
    path = write(tmp_path / "percent.csv", {"time": TIME, "position": position, "load [%]": torque})
    read = read_recording(path, columns={"torque": "load [%]:%*1.5"})
    np.testing.assert_allclose(read.torque, 0.015 * torque, rtol=1e-6)
