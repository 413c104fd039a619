"""Trends of a parameter over several recordings: drifts and jumps, tested against the scatter of its estimates."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from pendulum_env._typing import Array

FEWEST = 4  # estimates that show a trend: a line or a step leaves two degrees of freedom
BESIDE = 2  # estimates on either side of a jump: one alone may be an outlier
CONFIDENCE = 0.95  # of the interval of a drift


@dataclass(frozen=True)
class Jump:
    """A step of a parameter between two estimates."""

    first: int  # index of the first estimate after it
    size: float  # in the parameter's unit
    std: float  # standard error, scatter of the estimates included


@dataclass(frozen=True)
class Trend:
    """Change of a parameter over time.

    Attributes:
        drift: slope per unit of time, NaN for fewer than four estimates.
        interval: its 95 % confidence interval.
        jump: the step that explains the estimates better than any line, None if a line does.
        p_value: probability of a line or step as clear as this one if nothing changes.
    """

    drift: float = np.nan
    interval: tuple[float, float] = (np.nan, np.nan)
    jump: Jump | None = None
    p_value: float = np.nan


def fit_trend(time: Array, value: Array, std: Array) -> Trend:
    """Fit a drift to estimates, and test a line and a step at every date against a constant.

    The drift is the median of the slopes between all pairs of estimates (Theil-Sen). A line or step lowers chi-square
    by D, with weights 1/std^2. D has the chi-square distribution with one degree of freedom if the estimates scatter by
    their standard errors alone. Estimates of real machines scatter more, by temperature or lubrication. D over the
    remaining chi-square per degree of freedom then has the F distribution. The larger p-value counts, times the number
    of lines and steps tried (Bonferroni).

    Args:
        time: of the estimates (N,), in any unit.
        value: of the estimates (N,).
        std: their standard errors (N,), positive.

    Source: Sen, Journal of the American Statistical Association 63, 1968; Bevington and Robinson, Data Reduction and
    Error Analysis, chapter 11.
    """
    if len(time) < FEWEST or np.ptp(time) == 0:
        return Trend()
    order = np.argsort(time, kind="stable")
    t, w = time[order], 1 / std[order] ** 2
    x = value[order] - np.average(value[order], weights=w)
    drift, _, *interval = stats.theilslopes(x, t, CONFIDENCE)
    steps = 1 + np.flatnonzero(np.diff(t) > 0)
    steps = steps[(steps >= BESIDE) & (steps <= len(t) - BESIDE)]
    away, before, total = t - np.average(t, weights=w), np.cumsum(w)[steps - 1], w.sum()
    moments = np.r_[w @ away**2, before * (total - before) / total]  # of the line, then of every step
    changes = np.r_[w @ (away * x), -np.cumsum(w * x)[steps - 1]] / moments
    gains = changes**2 * moments  # D
    best, freedom = int(np.argmax(gains)), len(t) - 2
    remaining = max(1e-300, float(w @ x**2 - gains[best])) / freedom
    p_value = max(stats.chi2.sf(gains[best], 1), stats.f.sf(gains[best] / remaining, 1, freedom))
    error = np.sqrt(max(1.0, remaining) / moments[best])
    jump = Jump(int(order[steps[best - 1]]), float(changes[best]), float(error)) if best else None
    return Trend(float(drift), (float(interval[0]), float(interval[1])), jump, min(1.0, len(gains) * float(p_value)))
