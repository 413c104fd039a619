"""Does a parameter drift, or jump? A line through its estimates, and a step at every date, against a constant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from pendulum_env._typing import Array

FEWEST = 4  # estimates, of which a line or a step leaves two to judge the scatter by
SIDE = 2  # estimates on either side of a step: one alone may be an outlier


@dataclass(frozen=True)
class Course:
    """Estimates over time: their mean, and the line or step that tells most of how they differ from it.

    Attributes:
        level: weighted mean, in the parameter's unit.
        level_error: its standard error, scatter beyond the estimates' own errors included.
        excess: scatter about line or step in units of the standard errors (Birge ratio), 1 where they tell all of it.
        change: slope of the line, in the parameter's unit per unit of time, or height of the step; NaN where
            estimates are too few, or all of one moment.
        change_error: its standard error, scatter included.
        chance: that a steady parameter shows such a line or step; NaN likewise.
        first: index of the first estimate after the step; None if it is a line.
    """

    level: float
    level_error: float
    excess: float
    change: float = np.nan
    change_error: float = np.nan
    chance: float = np.nan
    first: int | None = None


def course(time: Array, value: Array, error: Array) -> Course:
    """Compare a constant with a line, and with a step at every date, by chi-square.

    With weights 1/error^2, a line or step lowers chi-square by D. Where only the standard errors scatter, D is of the
    chi-square distribution with one degree of freedom. Real joints scatter more (temperature, lubrication, mounting):
    then D over the chi-square left per degree of freedom is of the F distribution, and the larger chance counts, so
    that scatter is not taken for a change. Of all that are tried the one with the largest D is told, its chance times
    their number (Bonferroni).

    Args:
        time: when the estimates were made (N,), in any unit.
        value: of the estimates (N,).
        error: their standard errors (N,), positive.

    Source: Birge, Physical Review 40, 1932; Bevington and Robinson, Data Reduction and Error Analysis, chapter 11.
    """
    order = np.argsort(time, kind="stable")
    t, w, count = time[order], 1 / error[order] ** 2, len(time)
    total, level = float(w.sum()), float(np.average(value, weights=1 / error**2))
    x = value[order] - level
    square = float(w @ x**2)  # chi-square about the constant
    steady = _excess(square, count - 1)
    if count < FEWEST or np.ptp(t) == 0:
        return Course(level, steady / np.sqrt(total), steady)
    steps = 1 + np.flatnonzero(np.diff(t) > 0)
    steps = steps[(steps >= SIDE) & (steps <= count - SIDE)]
    away = t - np.average(t, weights=w)
    before = np.cumsum(w)[steps - 1]
    moments = np.r_[w @ away**2, before * (total - before) / total]  # of the line, then of every step
    changes = np.r_[w @ (away * x), -np.cumsum(w * x)[steps - 1]] / moments
    gains = changes**2 * moments
    best, freedom = int(np.argmax(gains)), count - 2
    left = max(0.0, square - float(gains[best]))
    excess = _excess(left, freedom)
    chance = max(stats.chi2.sf(gains[best], 1), stats.f.sf(gains[best] * freedom / max(left, 1e-300), 1, freedom))
    return Course(
        level,
        steady / np.sqrt(total),
        excess,
        float(changes[best]),
        excess / float(np.sqrt(moments[best])),
        min(1.0, len(gains) * float(chance)),
        int(order[steps[best - 1]]) if best else None,
    )


def _excess(square: float, freedom: int) -> float:
    return float(np.sqrt(max(1.0, square / freedom))) if freedom else 1.0
