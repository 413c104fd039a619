"""Normal equations that are kept apart, against plain least squares on the rows themselves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.regression.normal import Groups, Normal, quietest_most

FOLDS = 5


def problem(seed: int, recordings: int, parameters: int):
    rng = np.random.default_rng(seed)
    count = 40 * recordings
    owner, fold = np.repeat(np.arange(recordings), 40), rng.permutation(np.arange(count) % FOLDS)
    phi = rng.normal(size=(count, parameters)) * 10.0 ** rng.uniform(-3, 3, parameters)
    return np.column_stack([rng.normal(size=count), phi]), Groups.of(owner, fold, FOLDS)


def plainly(rows, weights):
    w = weights[:, None] * rows
    return np.linalg.lstsq(w[:, 1:], w[:, 0], rcond=None)[0]


def free(count: int):
    return np.full(count, -np.inf), np.full(count, np.inf)


@given(st.integers(0, 1000), st.integers(1, 3), st.integers(1, 5))
def test_solutions_are_those_of_the_rows(seed, recordings, parameters):
    rows, groups = problem(seed, recordings, parameters)
    weights = np.random.default_rng(seed).uniform(0.1, 1.0, recordings)
    normal = Normal.of(rows, groups, *free(parameters))
    each = weights[groups.owner]
    assert normal.solve(weights) == pytest.approx(plainly(rows, each), rel=1e-6, abs=1e-9)
    for fold, theta in enumerate(normal.solve_without(weights)):
        others = groups.fold != fold
        assert theta == pytest.approx(plainly(rows[others], each[others]), rel=1e-6, abs=1e-9)


@given(st.integers(0, 1000))
def test_further_columns_of_one_recording_are_as_good_as_zeros_in_the_others(seed):
    rows, groups = problem(seed, 3, 2)
    own = np.random.default_rng(seed + 1).normal(size=(40, 2))
    here = slice(40, 80)
    whole = np.column_stack([rows, np.zeros((len(rows), 2))])
    whole[here, 3:] = own
    beside = Normal.of(rows, groups, *free(2)).beside(rows, own, here, groups, *free(2))
    np.testing.assert_allclose(beside.grams, Normal.of(whole, groups, *free(4)).grams, atol=1e-9)


def test_a_parameter_that_would_leave_its_bound_stays_there():
    rows, groups = problem(1, 2, 3)
    best = plainly(rows, np.ones(len(rows)))
    least, most = free(3)
    most[1] = best[1] - abs(best[1])
    found = Normal.of(rows, groups, least, most).solve(np.ones(2))
    bound = rows[:, 0] - rows[:, 2] * most[1]
    others = np.linalg.lstsq(rows[:, [1, 3]], bound, rcond=None)[0]
    assert found == pytest.approx([others[0], most[1], others[1]], rel=1e-6)


def test_the_quietest_recording_counts_most_and_one_without_equations_not_at_all():
    rows, groups = problem(0, 2, 2)
    rows[:, 0] = np.where(groups.owner == 0, 1.0, 10.0)
    normal = Normal.of(rows, groups, *free(2))
    assert normal.weights(np.zeros(2), 0.0) == pytest.approx([1.0, 0.1])
    assert quietest_most(np.array([4.0, 0.0]), np.array([1, 0]), 0.5).tolist() == [1.0, 0.0]
    assert normal.weights(np.zeros(2), 5.0) == pytest.approx([1.0, 0.5])


def test_what_columns_alike_tell_is_left_to_a_method_that_keeps_its_digits():
    rows, groups = problem(0, 1, 2)
    rows[:, 2] = rows[:, 1]
    assert Normal.of(rows, groups, *free(2)).solve(np.ones(1)) is None
