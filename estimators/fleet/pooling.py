"""What is weak in each case and present in all: scores, added up over cases."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from estimators.selection.score import Bootstrap
from pendulum_env._typing import Array, Index

DRAWN = 1000  # parts of a sum over cases whose weights are drawn, at most: 100 MB or so


@dataclass(frozen=True)
class Pooled:
    """What an effect gains over several cases together.

    Attributes:
        total: log predictive density gained, less what choosing a form of the effect gains by chance [nat].
        error: its standard error, of the scatter within cases and between them [nat].
        chance: probability that nothing is gained.
        cases: number of cases.
    """

    total: float
    error: float
    chance: float
    cases: int


def pool(gain: Array, error: Array, variants: Index, rivals: int) -> Pooled:
    """Add up what an effect predicts better than its absence in each of several cases.

    The score of a diagnosis, one storey up: there a sum over stretches of time, here over recordings. Each case may
    have chosen its own form of the effect, so that the logarithm of their number is taken off in each; that of the
    effects and groups that were looked at is asked for once. The standard error of the sum is that of the scatter
    between cases, or of their own errors if those are larger, and the sum over it of Student's t: what only a few cases
    show is not sure of all.

    Args:
        gain: of each case (N,) [nat].
        error: its standard error (N,) [nat].
        variants: forms of the effect that each was the best of (N,).
        rivals: effects times groups that were looked at.

    Raises:
        ValueError: if there is no case.

    Source: as `estimators.selection.score`; sums over independent data sets are Bayes factors multiplied.
    """
    if not len(gain):
        raise ValueError("nothing to add up: no case tells what the effect gains")
    count = len(gain)
    net = gain - np.log(variants)
    between = count * float(net.var(ddof=1)) if count > 1 else 0.0
    spread = float(np.sqrt(max(between, float(error @ error), 1e-300)))
    total = float(net.sum())
    freedom = count - 1 if count > 1 else np.inf
    return Pooled(total, spread, float(stats.t.sf((total - np.log(rivals)) / spread, freedom)), count)


def weigh(gains: Array, rng: np.random.Generator | None = None) -> Array:
    """Probability of each of several effects (M,) that are weak in all of N cases, from what they gain (N, M) [nat].

    By pseudo-BMA+ over cases, as a diagnosis weighs rivals: effects that look alike share it. NaN, where nobody knows
    what an effect gains, counts as nothing gained. Of very many cases a few are drawn together, to bound memory.
    """
    drawn = min(len(gains), DRAWN)
    together = np.array([some.sum(axis=0) for some in np.array_split(np.nan_to_num(gains), drawn)])  # (drawn, M)
    bootstrap = Bootstrap(np.zeros(drawn, dtype=np.intp), rng or np.random.default_rng(0))
    return bootstrap.probabilities(list(together.T))
