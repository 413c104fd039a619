"""A clock of samples: the rate, gaps, and what is off the rate."""

import numpy as np
import pytest

from estimators.online.clock import Clock


def test_a_refused_sample_does_not_move_the_clock():
    clock = Clock(100.0)
    assert not any(clock.tick(time) for time in (0.0, 0.01))
    with pytest.raises(ValueError, match="not at 100 Hz"):
        clock.tick(0.015)
    with pytest.raises(ValueError, match=r"0\.005 s comes after one of 0\.01 s"):
        clock.tick(0.005)
    assert not any(clock.tick(time) for time in (0.02, 0.03))


def test_a_longer_time_is_a_gap_once_samples_have_kept_the_rate():
    clock = Clock(100.0)
    clock.tick(0.0)
    with pytest.raises(ValueError, match="rate="):
        clock.tick(1.0)
    clock.tick(0.01)
    assert clock.tick(1.0)
    assert not clock.tick(1.01)
    clock.restart()
    assert not clock.tick(0.0)
    assert not clock.tick(np.nan)
