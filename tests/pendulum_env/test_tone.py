"""Motion at one frequency is told from motion at several."""

import numpy as np
import pytest

from pendulum_env.tone import find_tone, has_one_frequency

TIME = np.arange(3000) / 250.0


@pytest.mark.parametrize("frequency", [0.7, 3.1, 40.0])
def test_the_frequency_of_a_sine_is_found_between_the_lines_of_its_spectrum(frequency):
    found, share = find_tone(2.0 + 0.3 * TIME + 5.0 * np.sin(frequency * TIME + 0.4), 1 / 250.0)
    assert found == pytest.approx(frequency, rel=1e-3)
    assert share == pytest.approx(1.0, abs=1e-4)


def test_a_triangle_and_two_sines_have_several_frequencies():
    triangle = np.abs((TIME % 2.0) - 1.0)
    share = find_tone(triangle, 1 / 250.0)[1]
    assert share == pytest.approx(96 / np.pi**4, abs=2e-3)  # of its first harmonic
    for series in (triangle, np.sin(3 * TIME) + 0.3 * np.sin(7 * TIME), np.random.default_rng(0).normal(size=3000)):
        assert not has_one_frequency(series, 1 / 250.0)
    assert has_one_frequency(np.sin(3 * TIME) + 0.03 * np.sin(7 * TIME), 1 / 250.0)


def test_fast_motion_in_a_long_log_counts():
    time = np.arange(60_000) / 100.0
    assert not has_one_frequency(np.sin(0.5 * time) + 0.2 * np.sin(21.0 * time), 0.01)
    assert has_one_frequency(np.sin(21.0 * time), 0.01)
