"""Since when? The date that best parts cases without a finding from later ones with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from pendulum_env._typing import Array, Index, Mask


@dataclass(frozen=True)
class Onset:
    """Where a finding sets in.

    Attributes:
        first: index of the first case after it, in the order of time.
        chance: that cases with and without it, in a random order, lie apart as well anywhere.
    """

    first: int
    chance: float


def onset(time: Array, found: Mask) -> Onset | None:
    """The place from which on a finding is more frequent than before; None if it is everywhere or nowhere.

    Fisher's exact test at every place; the chance of the smallest of its values is exact too: that of a random order of
    the cases, counted from the last one on, to reach one as small at any place.

    Args:
        time: of the cases (N,).
        found: whether each has it (N,).

    Source: Fisher, Statistical Methods for Research Workers, section 21.02; for the largest over places Worsley,
    Biometrika 70(2), 1983.
    """
    order = np.argsort(time, kind="stable")
    count, total = len(found), int(found.sum())
    places = 1 + np.flatnonzero(np.diff(time[order]) > 0)  # cases of one moment stay together
    if total in (0, count) or not len(places):
        return None
    after = total - np.cumsum(found[order])[places - 1]  # with the finding, from each place on
    chances = stats.hypergeom.sf(after - 1, count, total, count - places)
    best = int(np.argmin(chances))
    return Onset(int(order[places[best]]), _reached(count, total, count - places, float(chances[best])))


def _reached(count: int, total: int, tails: Index, chance: float) -> float:
    """Probability that in a random order of `count` cases, `total` of them with a finding, Fisher's test has `chance`.

    Or less, in any of the tails of these lengths. The number with the finding among the last j is a Markov chain, from
    which what reaches a tail's limit is taken out.
    """
    have = np.arange(total + 1)
    limits = {
        int(tail): have[stats.hypergeom.sf(have - 1, count, total, tail) <= chance * (1 + 1e-9)] for tail in tails
    }
    chain, reached = np.zeros(total + 1), 0.0
    chain[0] = 1.0
    for j in range(count - 1):
        up = chain * (total - have) / (count - j)
        chain = chain - up
        chain[1:] += up[:-1]
        if len(limit := limits.get(j + 1, have[:0])):
            reached += float(chain[limit].sum())
            chain[limit] = 0.0
    return min(1.0, reached)
