"""What is usual of errors is learnt from few, has no unit, and is surpassed as often as chance has it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators.online.usual import USUAL, Usual


@given(st.lists(st.floats(-20, 5), min_size=USUAL.fewest, max_size=40), st.floats(-30, 30), st.floats(-20, 20))
def test_what_is_usual_has_no_unit(told, unit, new):
    """Sizes are logs: in another unit, all are larger by the same; and what is larger surprises more."""
    both = Usual(2), Usual(2)
    for size in told:
        for usual, shift in zip(both, (0.0, unit), strict=True):
            usual.learn(np.full(2, size + shift))
    asked = np.full((1, 2), new)
    one, other = both[0].surprise(asked), both[1].surprise(asked + unit)
    assert one == pytest.approx(other, abs=1e-6)
    assert both[0].surprise(asked + 1.0) >= one and abs(one) <= USUAL.most


def test_few_errors_tell_little():
    usual = Usual(2)
    for _ in range(USUAL.fewest - 1):
        usual.learn(np.zeros(2))
    assert usual.surprise(np.full((1, 2), 100.0)) == 0.0
    usual.learn(np.zeros(2))
    first = usual.surprise(np.full((1, 2), 1.5))
    for _ in range(30):
        usual.learn(np.zeros(2))
    assert 0.0 < first < usual.surprise(np.full((1, 2), 1.5))


def test_what_is_usual_surprises_by_a_standard_error_however_many_are_asked():
    """The mean of sizes as those learnt is off by as much as both means are uncertain."""
    rng, told = np.random.default_rng(0), []
    for _ in range(400):
        usual = Usual(2)
        for size in rng.normal(size=(12, 2)):
            usual.learn(np.full(2, size[0]))
        told.append([usual.surprise(np.repeat(rng.normal(size=(n, 1)), 2, axis=1)) for n in (1, 24)])
    np.testing.assert_allclose(np.std(told, axis=0), 1.0, atol=0.2)


def test_an_error_is_larger_than_usual_only_if_it_is_so_in_each_unit():
    usual = Usual(2)
    for size in np.random.default_rng(0).normal(size=30):
        usual.learn(np.array([size, size]))
    for one in ([9.0, 0.0], [0.0, 9.0]):
        assert usual.surprise(np.array([one])) < 1.0
    assert usual.surprise(np.array([[9.0, 9.0]])) > 0.95 * USUAL.most
