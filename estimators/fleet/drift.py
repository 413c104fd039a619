"""Does a parameter drift, or jump? A line through its estimates, or a step, against a constant."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

from pendulum_env._typing import Array

FEWEST = 4  # estimates, of which a line leaves two to judge the scatter by
SIDE = 2  # estimates on either side of a jump


class Course(StrEnum):
    """How a parameter goes over time; `is` what may be said of it once many tests are weighed together."""

    STEADY = "steady"
    SCATTERS = "scatters"  # more than the standard errors allow, and to no end
    JUMPS = "jumps"
    DRIFTS = "drifts"


@dataclass(frozen=True)
class Drift:
    """A constant and a line, fitted to estimates over time.

    Attributes:
        level: weighted mean, in the parameter's unit.
        level_error: its standard error, scatter beyond the estimates' own errors included.
        slope: of the line, in the parameter's unit per unit of time.
        slope_error: its standard error, likewise.
        chance: that a steady parameter shows such a line; NaN where estimates are too few, or all of one moment.
        scatter: chance that a steady parameter, or a line, leaves as much as is left; NaN likewise.
        excess: scatter about the line in units of the standard errors (Birge ratio), 1 where they tell all of it.
        left: chi-square about the line, or the constant where there is none.
    """

    level: float
    level_error: float
    slope: float
    slope_error: float
    chance: float
    scatter: float
    excess: float
    left: float


@dataclass(frozen=True)
class Jump:
    """Two constants, one before a date and one from it on, at the date that parts the estimates best.

    Attributes:
        first: index of the first estimate after it.
        change: from one to the other, in the parameter's unit.
        error: its standard error, scatter beyond the estimates' own errors included.
        chance: that a steady parameter shows such a jump at any date.
        left: chi-square about the two.
    """

    first: int
    change: float
    error: float
    chance: float
    left: float


def drift(time: Array, value: Array, error: Array) -> Drift:
    """Compare a constant with a line by chi-square.

    With weights 1/error^2, the line lowers chi-square by D. Where only the standard errors scatter, D is of the
    chi-square distribution with one degree of freedom. Real joints scatter more (temperature, lubrication, mounting):
    then D over the chi-square left per degree of freedom is of the F distribution, and the larger chance counts, so
    that scatter is not taken for drift. Estimates without an error, or that are no numbers, are left out.

    Args:
        time: when the estimates were made (N,), in any unit.
        value: of the estimates (N,).
        error: their standard errors (N,), positive.

    Raises:
        ValueError: if the lengths differ, or no estimate has an error.

    Source: Birge, Physical Review 40, 1932; Bevington and Robinson, Data Reduction and Error Analysis, chapter 11.
    """
    if not len(time) == len(value) == len(error):
        raise ValueError(f"times, values and errors differ in number: {len(time)}, {len(value)}, {len(error)}")
    known = np.isfinite(time) & np.isfinite(value) & np.isfinite(error) & (error > 0)
    if not known.any():
        raise ValueError("no estimate has a standard error: nothing tells how much it may scatter")
    t, x, w = time[known], value[known], 1 / error[known] ** 2
    count, total = len(t), float(w.sum())
    mean = float(w @ x) / total
    centre = float(w @ t) / total
    moment = float(w @ (t - centre) ** 2)
    constant = float(w @ (x - mean) ** 2)
    if count < FEWEST or np.ptp(t) == 0:
        left = count - 1
        excess = _excess(constant, left)
        scatter = float(stats.chi2.sf(constant, left)) if left else np.nan
        return Drift(mean, excess / np.sqrt(total), np.nan, np.nan, np.nan, scatter, excess, constant)
    slope = float(w @ ((t - centre) * (x - mean))) / moment
    gain = slope**2 * moment
    rest, left = float(w @ (x - mean - slope * (t - centre)) ** 2), count - 2
    excess = _excess(rest, left)
    return Drift(
        mean,
        _excess(constant, count - 1) / np.sqrt(total),
        slope,
        excess / np.sqrt(moment),
        _chance(gain, rest, left),
        float(stats.chi2.sf(rest, left)),
        excess,
        rest,
    )


def jump(time: Array, value: Array, error: Array) -> Jump | None:
    """Compare a constant with a step, by the tests of `drift` at every date, times their number (Bonferroni).

    None where no date has two estimates on either side: one alone may be an outlier.

    Args:
        time: when the estimates were made (N,), in any unit.
        value: of the estimates (N,).
        error: their standard errors (N,), positive.
    """
    order = np.argsort(time, kind="stable")
    x, w = value[order], 1 / error[order] ** 2
    places = 1 + np.flatnonzero(np.diff(time[order]) > 0)
    places = places[(places >= SIDE) & (places <= len(x) - SIDE)]
    if not len(places):
        return None
    weights, sums = np.cumsum(w), np.cumsum(w * x)
    before, after = weights[places - 1], weights[-1] - weights[places - 1]
    changes = (sums[-1] - sums[places - 1]) / after - sums[places - 1] / before
    shared = before * after / weights[-1]
    gains = changes**2 * shared
    best, left = int(np.argmax(gains)), len(x) - 2
    rest = max(0.0, float(w @ (x - sums[-1] / weights[-1]) ** 2 - gains[best]))
    return Jump(
        int(order[places[best]]),
        float(changes[best]),
        float(_excess(rest, left) / np.sqrt(shared[best])),
        min(1.0, len(places) * _chance(float(gains[best]), rest, left)),
        rest,
    )


def _chance(gain: float, rest: float, left: int) -> float:
    """Chance that one more parameter lowers chi-square by `gain`, to `rest`, where it is none."""
    return float(max(stats.chi2.sf(gain, 1), stats.f.sf(gain * left / max(rest, 1e-300), 1, left)))


def _excess(square: float, left: int) -> float:
    return float(np.sqrt(max(1.0, square / left))) if left else 1.0
