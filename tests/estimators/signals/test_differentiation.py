"""Noise of differentiated signals."""

import numpy as np
import pytest

from estimators.signals.differentiation import shared


@pytest.mark.parametrize("lag", [1, 3, 6])
@pytest.mark.parametrize("difference", [[1.0], [1.0, -2.0, 1.0]])
def test_averages_of_white_noise_share_what_their_weights_overlap(lag, difference):
    weights = np.convolve(np.hanning(13)[1:-1], difference)
    noise = np.random.default_rng(1).standard_normal(200_000)
    averages = np.convolve(noise, weights, mode="valid")
    measured = np.corrcoef(averages[lag:], averages[:-lag])[0, 1]
    assert shared(weights, lag) == pytest.approx(measured, abs=0.02)
