"""Which of several siblings differs? Each against what the others lead to expect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from pendulum_env._typing import Array

FEWEST = 3  # others, of which one has to be told apart


@dataclass(frozen=True)
class Odd:
    """One of several siblings beside the others.

    Attributes:
        expected: mean of the others.
        spread: standard deviation of what one more of their kind would show: how the others differ truly, how well
            their mean is known, and its own error.
        chance: that one of their kind lies as far off; NaN where siblings are too few.
    """

    expected: float
    spread: float
    chance: float


def odd_ones(value: Array, error: Array) -> list[Odd]:
    """Compare each of several siblings (N,) with the others.

    Machines of one kind differ a little. How much, the others tell: their true variance is what their scatter leaves
    beyond their errors (DerSimonian and Laird), and the distance is of Student's t. The one under test is left out, so
    that it does not excuse itself.

    Args:
        value: of each sibling (N,), finite.
        error: its standard error (N,), positive.

    Source: DerSimonian and Laird, Controlled Clinical Trials 7, 1986; Higgins, Thompson and Spiegelhalter, JRSS A
    172(1), 2009, for the prediction of one more.
    """
    count = len(value) - 1  # of the others
    if count < FEWEST:
        return [Odd(np.nan, np.nan, np.nan)] * len(value)
    found = []
    for k in range(len(value)):
        mean, variance, true = _random_effects(np.delete(value, k), np.delete(error, k))
        spread = float(np.sqrt(true + variance + error[k] ** 2))
        found.append(Odd(mean, spread, 2 * float(stats.t.sf(abs(value[k] - mean) / spread, count - 1))))
    return found


def _random_effects(value: Array, error: Array) -> tuple[float, float, float]:
    """Mean of siblings, its variance, and their true variance."""
    w = 1 / error**2
    fixed = w @ value / w.sum()
    surplus = w @ (value - fixed) ** 2 - (len(value) - 1)
    true = max(0.0, float(surplus / (w.sum() - (w @ w) / w.sum())))
    w = 1 / (error**2 + true)
    return float(w @ value / w.sum()), float(1 / w.sum()), true
