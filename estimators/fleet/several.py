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
    named = np.zeros(len(chances), dtype=bool)
    tested = np.flatnonzero(np.isfinite(chances))
    order = tested[np.argsort(chances[tested], kind="stable")]
    for left, k in zip(range(len(order), 0, -1), order, strict=True):
        if not chances[k] * left <= level:
            break
        named[k] = True
    return named
