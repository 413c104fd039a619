"""A sample costs a few bounded parts of the computation, and the diagnosis does not depend on how it is spread."""

import numpy as np
import pytest

from estimators.online.binning import Bins
from estimators.online.recursion import RootRecursion, SquareRootLeastSquares
from estimators.online.settings import ONLINE
from estimators.regression.recursive import PRIOR
from tests.estimators.online.test_diagnosis import FEW, RATE, diagnoser, recorded
from tests.feeding import feed

SECONDS = 9.0  # with refinements of the grids after 2 and 4 s of motion


def numbers(verdict):
    """Return all numbers of a verdict."""
    ranking = [
        (one.effect, one.term, one.probability, one.gain, one.evidence, *one.theta.items()) for one in verdict.ranking
    ]
    return repr(verdict), verdict.theta, ranking


def test_work_at_once_and_in_parts_gives_the_same_diagnosis():
    spread, at_once = diagnoser(library=FEW), diagnoser(library=FEW)
    recording = recorded("cogging")
    feed(spread, recording, 0, round(SECONDS * RATE))
    for k in range(round(SECONDS * RATE)):
        feed(at_once, recording, k, k + 1)
        at_once.finish()
    (later,), (verdict,) = spread.finish(), at_once.diagnoses
    assert later.kind == "missing" and later.group == ("cogging",)
    assert numbers(later) == numbers(verdict)


def test_a_diagnosis_is_less_than_a_second_late():
    recording, spread, at_once, late = recorded("cogging"), diagnoser(), diagnoser(), []
    for k in range(round(6.0 * RATE)):
        (verdict,) = feed(spread, recording, k, k + 1)[0]
        feed(at_once, recording, k, k + 1)
        (expected,) = at_once.finish()
        late.append(verdict.motion < expected.motion)
    waits = np.diff(np.flatnonzero(np.diff(np.r_[0, late, 0])))[::2]  # samples with an old diagnosis
    assert len(waits) >= 2 and waits.max() < RATE


@pytest.mark.parametrize("seconds", [4.0, SECONDS])
def test_a_step_evaluates_few_rows_however_long_the_motion_was(monkeypatch, seconds):
    """The longest fit has 1600 bins; a part evaluates all bins of one variant, or few bins of many."""
    one, sizes, total = diagnoser(), [], 0
    evaluate = Bins.evaluate_rows

    def count_rows(bins, terms, count=1):
        nonlocal total
        total += len(bins.y) * count
        return evaluate(bins, terms, count)

    monkeypatch.setattr(Bins, "evaluate_rows", count_rows)
    for k in range(round(seconds * RATE)):
        feed(one, recorded("cogging"), k, k + 1)
        sizes.append(total)
        total = 0
    parts = np.ceil(ONLINE.work.per_bin / round(ONLINE.bins.length * RATE))
    assert max(sizes) <= parts * ONLINE.work.rows


@pytest.mark.parametrize("forgetting", [1.0, 0.98])
def test_roots_are_those_of_recursive_least_squares(forgetting):
    rng, size = np.random.default_rng(0), 3
    one = RootRecursion(np.sqrt(PRIOR) * np.eye(size), (1.0, forgetting))
    other = SquareRootLeastSquares((1, 1), size, forgetting=forgetting)
    for phi in rng.normal(size=(300, size)) * [1.0, 0.1, 0.0]:
        direction = other.P[0, 0] @ phi / forgetting
        np.testing.assert_allclose(one.compute_direction(phi)[1], direction, rtol=1e-6, atol=1e-9)
        one.take(phi)
        other.take(phi[None, None], np.zeros((1, 1)), np.ones((1, 1), dtype=bool))
    np.testing.assert_allclose(one.root[1] @ one.root[1].T, other.P[0, 0], rtol=1e-6, atol=1e-9)


def test_a_reset_removes_the_work_that_waits():
    one = diagnoser(library=FEW)
    feed(one, recorded("cogging"), 0, round(3.5 * RATE))
    one.reset()
    (verdict,) = one.finish()
    assert verdict.kind == "calibrating" and not verdict.ranking
