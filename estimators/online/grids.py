"""Which variants of an effect run at once: few at first, then more of them where the data are.

Orders, which are integers, all run from the beginning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.online.rivals import Family
from pendulum_env.physics import Term

FEW = 12  # variants of a grid that are run, where a shape parameter is continuous


def refined(family: Family, fresh: Sequence[Term]) -> list[Term]:
    """Variants to go on with: the best two, those halfway to the neighbours of the best, and some of a fresh grid."""
    best = family.variants[family.best]
    kept = [family.variants[k] for k in np.argsort(-family.weight)[:2]]
    near = []
    for shape in best.free:
        value = best.shape[shape.name]
        if shape.integer or not np.isfinite(value):
            continue
        values = np.unique([variant.shape[shape.name] for variant in family.variants])
        values = values[np.isfinite(values)]
        at = int(np.searchsorted(values, value))
        lower = values[at - 1] if at else value / 2
        upper = values[at + 1] if at + 1 < len(values) else 2 * value
        for other in (lower, upper):
            middle = np.sqrt(value * other) if value * other > 0 else 0.5 * (value + other)
            if shape.low <= middle <= shape.high:
                near.append(replace(best, **{shape.name: float(middle)}))
    return list(dict.fromkeys([*kept, best, *near, *thinned(fresh)]))


def thinned(variants: Sequence[Term]) -> list[Term]:
    """All variants whose shapes are integers; of others as many as are run."""
    if not variants or all(shape.integer for shape in variants[0].shapes) or len(variants) <= FEW:
        return list(variants)
    return [variants[k] for k in np.unique(np.linspace(0, len(variants) - 1, FEW).round().astype(int))]
