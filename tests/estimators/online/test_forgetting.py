"""The mixture of models with forgetting gains by better predictions alone."""

import numpy as np
import pytest

from estimators.online.binning import ModelRows
from estimators.online.forgetting import ForgettingMixture


@pytest.mark.parametrize(("passed", "gains"), [(1.0, True), (0.01, False)])
def test_a_law_that_passes_almost_none_of_the_torque_gains_nothing_by_that(passed, gains):
    """The errors are those of a good prediction; the running model is given a poor density."""
    rng = np.random.default_rng(0)
    mixture = ForgettingMixture(np.array([1.0]), np.array([[0.1]]), 1e-4, [50.0])
    rows = rng.normal(size=(40, 1))
    densities = [mixture.take(ModelRows(phi, phi[0], np.zeros(1), passed), -3.0) for phi in rows]
    assert (sum(densities) > -3.0 * len(rows) + 1.0) == gains
