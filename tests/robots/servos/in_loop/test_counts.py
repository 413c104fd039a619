"""Step of an encoder from logged positions."""

import numpy as np
import pytest

from pendulum_env.recording import Recording
from robots.servos.in_loop.counts import find_encoder_step

TIME = np.arange(500) / 100.0
MOTION = 0.7 * np.sin(3.0 * TIME) + 0.2 * np.sin(7.3 * TIME)


def log(position: np.ndarray) -> Recording:
    return Recording(TIME, position, np.ones(len(TIME)), name="log")


@pytest.mark.parametrize("counts", [1024, 4096, 16384])
@pytest.mark.parametrize("zero", [0.0, 1.2345])
def test_step_of_an_encoder_is_found_though_the_log_prints_decimals_and_has_another_zero(counts, zero):
    count = 2 * np.pi / counts
    positions = [np.round((MOTION + shift) / count) * count + zero for shift in (0.0, 0.1)]
    assert find_encoder_step([log(np.round(own, 5)) for own in positions]) == pytest.approx(count, rel=1e-3)


def test_positions_with_noise_of_two_encoders_or_at_rest_have_no_step():
    rounded = [np.round(MOTION / count) * count for count in (1e-3, 1.7e-3)]
    assert find_encoder_step([log(MOTION + np.random.default_rng(0).normal(0.0, 1e-3, len(TIME)))]) is None
    assert find_encoder_step([log(own) for own in rounded]) is None
    assert find_encoder_step([log(np.zeros(len(TIME)))]) is None
