"""Trends of a parameter over several recordings: drifts and jumps, tested against the scatter of its estimates."""

from dataclasses import dataclass

import numpy as np
import scipy

from pendulum_env._typing import Array, Index

MIN_ESTIMATES = 4  # least number of estimates of a trend, with two degrees of freedom beyond a line or step
MIN_PER_SIDE = 2  # least number of estimates on either side of a jump; a single estimate may be an outlier
CONFIDENCE = 0.95  # level of the interval of a drift


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
        jump: step that explains the estimates better than a line; None if a line is better.
        p_value: upper bound of the probability of a line or step with this gain, for a constant parameter.
    """

    drift: float = np.nan
    interval: tuple[float, float] = (np.nan, np.nan)
    jump: Jump | None = None
    p_value: float = np.nan


def fit_trend(time: Array, value: Array, std: Array) -> Trend:
    """Fit a drift to estimates, and test a line and a step at every date against a constant.

    The drift is the median of the slopes between all pairs of estimates (Theil-Sen). Estimates of real machines scatter
    by more than their standard errors, by temperature or lubrication. With the variance s^2 of this scatter, a constant
    has a chi-square of N - 1 (Paule-Mandel). A line or step lowers chi-square by D, with weights 1/(std^2 + s^2). D
    over the remaining chi-square per degree of freedom has the F distribution. With weights 1/std^2 and no further
    scatter, D has the chi-square distribution with one degree of freedom. The larger p-value of both is multiplied by
    the number of tried lines and steps (Bonferroni). It is 1 if a line is best and the interval of the drift contains
    zero.

    Args:
        time: times of the estimates (N,), in any unit.
        value: estimates (N,).
        std: their standard errors (N,), positive.

    Source: Sen, Journal of the American Statistical Association 63, 1968; Paule and Mandel, Journal of Research of the
    National Bureau of Standards 87(5), 1982; Bevington and Robinson, Data Reduction and Error Analysis, chapter 11.
    """
    if len(time) < MIN_ESTIMATES or np.ptp(time) == 0:
        return Trend()
    order = np.argsort(time, kind="stable")
    t, x, variance = time[order], value[order], std[order] ** 2
    drift, _, low, high = map(float, scipy.stats.theilslopes(x, t, CONFIDENCE))
    steps = 1 + np.flatnonzero(np.diff(t) > 0)
    steps = steps[(steps >= MIN_PER_SIDE) & (steps <= len(t) - MIN_PER_SIDE)]
    fits = _fit_changes(t, x, 1 / (variance + estimate_scatter_variance(x, variance)), steps)
    white_fits = _fit_changes(t, x, 1 / variance, steps)  # scatter by standard errors alone
    best, freedom = int(np.argmax(fits.gains)), len(t) - 2
    remaining = max(1e-300, fits.chi_square - float(fits.gains[best])) / freedom
    p_value = max(
        scipy.stats.chi2.sf(white_fits.gains[best], 1), scipy.stats.f.sf(fits.gains[best] / remaining, 1, freedom)
    )
    if not best:
        p_value = 1.0 if low <= 0 <= high else p_value
        return Trend(drift, (low, high), None, min(1.0, len(fits.gains) * float(p_value)))
    error = np.sqrt(max(remaining / fits.moments[best], 1 / white_fits.moments[best]))
    jump = Jump(int(order[steps[best - 1]]), float(fits.changes[best]), float(error))
    return Trend(drift, (low, high), jump, min(1.0, len(fits.gains) * float(p_value)))


def estimate_scatter_variance(value: Array, variance: Array) -> float:
    """Estimate the scatter variance s^2 of values (N,) beyond the variance of their errors (N,), see `fit_trend`."""

    def compute_excess(s2: float) -> float:
        w = 1 / (variance + s2)
        return float(w @ (value - np.average(value, weights=w)) ** 2) - (len(value) - 1)

    upper = float(np.sum((value - value.mean()) ** 2))  # chi-square is below 1 with this variance
    return (
        float(scipy.optimize.brentq(compute_excess, 0.0, upper, xtol=1e-9 * upper)) if compute_excess(0.0) > 0 else 0.0
    )


@dataclass(frozen=True, eq=False)
class _Changes:
    """A line, then every step: slope or height, weighted moment, and decrease of chi-square, each (1 + S,)."""

    changes: Array
    moments: Array
    gains: Array  # D
    chi_square: float  # of a constant


def _fit_changes(t: Array, x: Array, w: Array, steps: Index) -> _Changes:
    """Fit a line, and a step before each index of `steps` (S,), to x (N,) at times t with weights w."""
    x, deviation = x - np.average(x, weights=w), t - np.average(t, weights=w)
    weight_before, total = np.cumsum(w)[steps - 1], w.sum()
    moments = np.r_[w @ deviation**2, weight_before * (total - weight_before) / total]
    changes = np.r_[w @ (deviation * x), -np.cumsum(w * x)[steps - 1]] / moments
    return _Changes(changes, moments, changes**2 * moments, float(w @ x**2))
