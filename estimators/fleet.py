"""What many diagnoses show together: which parameters drift, which joints differ, what is weak in each and in all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from estimators.selection.score import Bootstrap
from pendulum_env._typing import Array, Index, Mask

LEVEL = 0.01  # probability of any finding of one kind in a fleet in which nothing happens


@dataclass(frozen=True)
class Fewest:
    """The least that a statement about a fleet rests on."""

    estimates: int = 4  # that show a change: a line or a step leaves two to judge the scatter by
    beside: int = 2  # estimates on either side of a step: one alone may be an outlier
    siblings: int = 3  # others, of which one can be told apart
    summed: int = 1000  # parts of a sum over cases that are weighted at random, at most: bounds memory to some 100 MB


FEWEST = Fewest()


@dataclass(frozen=True)
class Course:
    """Estimates over time: their mean, and the line or step that explains most of how they differ from it.

    The change is NaN where estimates are too few, or all of one moment.
    """

    level: float  # weighted mean, in the parameter's unit
    level_error: float  # its standard error, scatter beyond the estimates' own errors included
    excess: float  # scatter about line or step in units of the standard errors (Birge ratio), at least 1
    change: float = np.nan  # slope of the line, per unit of time, or height of the step
    change_error: float = np.nan  # its standard error, scatter included
    p_value: float = np.nan  # p-value of the change
    first: int | None = None  # index of the first estimate after the step; None if it is a line


def course(time: Array, value: Array, error: Array) -> Course:
    """Compare a constant with a line, and with a step at every date, by chi-square.

    With weights 1/error^2, a line or step lowers chi-square by D. If only the standard errors scatter, D has the
    chi-square distribution with one degree of freedom. Real joints scatter more (temperature, lubrication, mounting):
    then D over the remaining chi-square per degree of freedom has the F distribution, and the larger p-value counts,
    so that scatter is not taken for a change. The largest D counts, its p-value times the number of shapes tried
    (Bonferroni).

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
    if count < FEWEST.estimates or np.ptp(t) == 0:
        return Course(level, steady / np.sqrt(total), steady)
    steps = 1 + np.flatnonzero(np.diff(t) > 0)
    steps = steps[(steps >= FEWEST.beside) & (steps <= count - FEWEST.beside)]
    away = t - np.average(t, weights=w)
    before = np.cumsum(w)[steps - 1]
    moments = np.r_[w @ away**2, before * (total - before) / total]  # of the line, then of every step
    changes = np.r_[w @ (away * x), -np.cumsum(w * x)[steps - 1]] / moments
    gains = changes**2 * moments
    best, freedom = int(np.argmax(gains)), count - 2
    left = max(0.0, square - float(gains[best]))
    excess = _excess(left, freedom)
    p_value = max(stats.chi2.sf(gains[best], 1), stats.f.sf(gains[best] * freedom / max(left, 1e-300), 1, freedom))
    return Course(
        level,
        steady / np.sqrt(total),
        excess,
        float(changes[best]),
        excess / float(np.sqrt(moments[best])),
        min(1.0, len(gains) * float(p_value)),
        int(order[steps[best - 1]]) if best else None,
    )


def _excess(square: float, freedom: int) -> float:
    return float(np.sqrt(max(1.0, square / freedom))) if freedom else 1.0


@dataclass(frozen=True)
class Onset:
    """Where a finding sets in: index of the first case after it, in the order of time, and the p-value."""

    first: int
    p_value: float


def onset(time: Array, found: Mask) -> Onset | None:
    """The place from which on a finding is more frequent than before; None if it is everywhere or nowhere.

    Fisher's exact test at every place. The p-value of the smallest of them is exact too: the probability that cases in
    a random order reach one as small at any place.

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
    p_values = stats.hypergeom.sf(after - 1, count, total, count - places)
    best = int(np.argmin(p_values))
    return Onset(int(order[places[best]]), _reached(count, total, count - places, float(p_values[best])))


def _reached(count: int, total: int, tails: Index, p_value: float) -> float:
    """Probability that Fisher's test reaches `p_value` in any of the tails of a random order.

    Of `count` cases `total` have the finding. Their number among the last j is a Markov chain, from which whatever
    reaches a tail's limit is taken out.
    """
    have = np.arange(total + 1)
    limits = {
        int(tail): have[stats.hypergeom.sf(have - 1, count, total, tail) <= p_value * (1 + 1e-9)] for tail in tails
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


@dataclass(frozen=True)
class Pooled:
    """What an effect gains over several cases together."""

    total: float  # log predictive density gained, less what choosing a form of the effect gains by chance [nat]
    error: float  # its standard error, of the scatter within cases and between them [nat]
    p_value: float  # probability that nothing is gained
    cases: int


def pool(gain: Array, error: Array, variants: Index, rivals: int) -> Pooled:
    """Add up the gains in prediction of an effect over several cases.

    Each case may have chosen its own form of the effect: the logarithm of their number is subtracted in each, that of
    the effects and groups that were looked at once. The standard error of the sum is that of the scatter between
    cases, or of their own errors if those are larger, and the sum over it has Student's distribution: an effect in a
    few cases is not significant for all.

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


def weigh(gains: Array) -> Array:
    """Probability (M,) of each of several effects that are weak in all of N cases, from their gains (N, M) [nat].

    By pseudo-BMA+ over cases: effects that look alike share it. NaN, an unknown gain, counts as none.
    """
    parts = min(len(gains), FEWEST.summed)
    together = np.array([some.sum(axis=0) for some in np.array_split(np.nan_to_num(gains), parts)])  # (parts, M)
    bootstrap = Bootstrap(np.zeros(parts, dtype=np.intp), np.random.default_rng(0))
    return bootstrap.probabilities(list(together.T))


def significant(p_values: Array, level: float = LEVEL) -> Mask:
    """Which of several p-values (N,) are significant together; NaN counts as no test.

    The probability that any of those named is false is at most the level, however they depend on each other.
    Source: Holm, Scandinavian Journal of Statistics 6, 1979.
    """
    order = np.argsort(p_values, kind="stable")  # NaN last, which no comparison holds for
    left = np.count_nonzero(np.isfinite(p_values)) - np.arange(len(p_values))  # tests, the smaller ones having held
    named = np.zeros(len(p_values), dtype=bool)
    named[order] = np.logical_and.accumulate(p_values[order] * left <= level)
    return named


@dataclass(frozen=True)
class Odd:
    """One of several siblings beside the others; NaN where they are too few."""

    expected: float  # mean of the others
    spread: float  # standard deviation of one more of their kind: true differences, error of the mean, own error
    p_value: float  # p-value of its distance


def odd_ones(value: Array, error: Array) -> list[Odd]:
    """Compare each of several siblings (N,) with the others.

    Machines of one kind differ a little. Their true variance is what the scatter of the others leaves beyond their
    errors (DerSimonian and Laird), and the distance has Student's distribution. The one under test is left out of it.

    Args:
        value: of each sibling (N,), finite.
        error: its standard error (N,), positive.

    Source: DerSimonian and Laird, Controlled Clinical Trials 7, 1986; Higgins, Thompson and Spiegelhalter, JRSS A
    172(1), 2009, for the prediction of one more.
    """
    count = len(value) - 1  # of the others
    if count < FEWEST.siblings:
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
