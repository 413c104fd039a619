"""Many tests at once: a fleet has hundreds of parameters, of which some are extreme by chance."""

from __future__ import annotations

import numpy as np

from pendulum_env._typing import Array, Mask

LEVEL = 0.01  # chance that anything at all is named of a fleet in which nothing happens, for each kind of finding


def surely(chances: Array, level: float = LEVEL) -> Mask:
    """Which of several findings (N,) hold together, given the chance that each comes about where nothing is.

    The chance that any of those named is false is at most the level, however the findings depend on each other. NaN,
    where nothing could be tested, counts as no test. Source: Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(chances, kind="stable")  # NaN last, which no comparison holds for
    left = np.count_nonzero(np.isfinite(chances)) - np.arange(len(chances))  # tests, the smaller ones having held
    named = np.zeros(len(chances), dtype=bool)
    named[order] = np.logical_and.accumulate(chances[order] * left <= level)
    return named
