"""The simulated rig: a plant seen through an encoder and a noisy torque channel."""

import numpy as np
import pytest

from pendulum_env.backends import record
from pendulum_env.excitation import excitation


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def run(rng, model=None, seconds=2.0, **options):
    return record(model, excitation("paper", np.random.default_rng(0), seconds), seconds, rng=rng, **options)


def test_a_recording_is_as_long_and_as_noisy_as_asked_for_and_repeats():
    clean, noisy, again = (run(5, rate=500.0, counts=4096, torque_noise=noise) for noise in (0.0, 0.1, 0.1))
    assert len(noisy) == 1000 and noisy.rate == pytest.approx(500.0) and noisy.time[0] == 0.0
    assert np.array_equal(clean.position, noisy.position) and np.array_equal(noisy.torque, again.torque)
    assert (noisy.torque - clean.torque).std() == pytest.approx(0.1, rel=0.1)
    turns = noisy.position / (2 * np.pi) * 4096
    assert turns == pytest.approx(np.round(turns), abs=1e-6)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"rate": 0.0}, "needs rate above zero"),
        ({"rate": 0.6}, "1 samples, at least 2"),
        ({"counts": -1}, "counts"),
        ({"torque_noise": -0.1}, "torque_noise"),
    ],
)
def test_numbers_out_of_range_are_refused(rng, options, match):
    with pytest.raises(ValueError, match=match):
        run(rng, **options)
