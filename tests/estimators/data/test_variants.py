"""Starts of a search over nonlinear parameters."""

import pytest

from estimators.data.rows import ScoredTerms
from estimators.data.variants import choose_starts
from pendulum_env.physics import BASE
from pendulum_env.physics.friction import Stribeck


@pytest.mark.parametrize(
    ("errors", "starts"),
    [
        ([5.0, 2.0, 1.0, 3.0, 4.0], [2]),  # one basin: its neighbours lead to the same minimum
        ([2.5, 3.0, 4.0, 1.0, 2.0], [3, 0]),  # the neighbour at 4 has a smaller error than the other basin at 0
        ([1.0, 2.0, 0.5, 2.0, 0.7], [2, 4]),
    ],
)
def test_a_search_starts_from_the_best_values_of_different_basins(errors, starts):
    trials = [ScoredTerms((*BASE, Stribeck(0.1 * (k + 1))), error) for k, error in enumerate(errors)]
    ranked = sorted(trials, key=lambda trial: trial.fitted_rms)
    assert [trials.index(trial) for trial in choose_starts(ranked)] == starts
