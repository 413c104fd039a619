"""The one score: log predictive density of stretches of time that a model was not fitted to.

A model is fitted to all stretches but a tenth, which it then has to predict; held-out recordings are predicted from the
fit to all others. What is left is taken as Student's t, since real errors have tails, and the density is that of the
torque that was recorded, whatever becomes of it on its way to the joint. What one model gains over another is the sum
of the differences, and how sure that is, their scatter tells: on a real machine no model is complete, residuals are
correlated for seconds, and only what repeats from stretch to stretch and from recording to recording is sure.

The scatter enters by the Bayesian bootstrap: stretches, and recordings, are given random weights, many times over. The
share of draws in which nothing is gained is the chance that an effect is none; the mean of the softmax over rivals is
the probability of each (pseudo-BMA+).

Source: Vehtari, Gelman and Gabry, Statistics and Computing 27, 2017; Yao, Vehtari, Simpson and Gelman, Bayesian
Analysis 13(3), 2018; Rubin, Annals of Statistics 9(1), 1981; for the online form Dawid, JRSS A 147(2), 1984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from estimators.regression.least_squares import Balance
from pendulum_env._typing import JSON, Array, Index, Mask

NU = 4.0  # degrees of freedom of Student's t,
PEAK = float(np.exp(gammaln((NU + 1) / 2) - gammaln(NU / 2)) / np.sqrt(NU * np.pi))  # and its density at zero
FOLDS = 10  # of cross-validation
STRETCH = 1.0  # [s]
DRAWS = 4000  # of the Bayesian bootstrap
TURNS, SETTLED = 20, 1e-5  # of the fixed point for a scale, and relative change at which it ends
DIVERGED = 1e60  # [N m], a prediction as far off is as bad as any


Hidden = Sequence[tuple[slice, float]]  # rows, and variance of the torque noise that a model takes out of them


@dataclass(frozen=True)
class Stretches:
    """Which stretch and which recording every equation lies in (R,), and the recording of every stretch (S,).

    Folds of cross-validation are whole stretches, or pieces of them where the torque of one moment may tell that of the
    next: `piece` numbers these (R,).
    """

    stretch: Index
    recording: Index
    of_stretch: Index
    piece: Index

    @property
    def fold(self) -> Index:
        """Fold of every equation (R,)."""
        return np.asarray(self.piece % FOLDS)


def cross_validated(balance: Balance, where: Stretches, hidden: Hidden = (), theta: Array | None = None) -> Array:
    """Log density of each stretch (S,), predicted by the fit to the others [nat].

    Args:
        balance: equations of the model.
        where: stretch and recording of each equation.
        hidden: what torque noise the model takes out of the equations, which counts as error all the same.
        theta: parameters that are fitted without each fold (FOLDS, P), where they are known.
    """
    return _density(balance, balance.solve_without(where.fold, FOLDS) if theta is None else theta, where, hidden)


def predicted(theta: Array, balance: Balance, where: Stretches, hidden: Hidden = ()) -> Array:
    """Log density of each held-out stretch (S,) under parameters (P,) fitted elsewhere [nat]."""
    return _density(balance, theta[None], where, hidden)


def _density(balance: Balance, theta: Array, where: Stretches, hidden: Hidden) -> Array:
    """Log density of the torque recorded in each stretch, from fits without each fold (FOLDS, P), or from one (1, P).

    It is that of what the equations leave, times how much of it each N m of recorded torque is: a law under which next
    to nothing is left, since next to none of the torque comes through, tells as little of what was recorded. No torque
    is less likely than if nothing but its size were known. The scale is that of the other folds of the same recording:
    recordings differ in what no model explains of them.
    """
    left, slopes = balance.residual(theta)
    left = np.clip(left, -DIVERGED, DIVERGED)
    for rows, variance in hidden:
        left[:, rows] *= np.sqrt(1 + variance / max(float(np.mean(left[:, rows] ** 2)), 1e-300))
    fold, reach = where.fold, balance.reach
    total = np.zeros(len(where.of_stretch))
    for k in np.unique(fold):
        test, own = fold == k, min(k, len(left) - 1)
        square = _scales(left[own], where.recording, test)[where.recording[test]]
        density = np.log(PEAK / np.sqrt(square)) - (NU + 1) / 2 * np.log1p(left[own, test] ** 2 / (NU * square))
        known = np.minimum(np.sqrt(square) / (PEAK * reach[test]), 1.0)  # no law tells less than one that fits nothing
        density += np.log(np.maximum(slopes[own, test], known))
        total += np.bincount(where.stretch[test], density, len(total))
    return total


def _scales(errors: Array, recording: Index, test: Mask) -> Array:
    """Squared maximum-likelihood scale of Student's t of each recording's errors, without those that are predicted.

    Args:
        errors: (R,).
        recording: of each.
        test: those that are predicted (R,); a recording with no others is judged by them all the same.
    """
    count = int(recording.max()) + 1
    known = ~test
    known |= np.bincount(recording, known, count)[recording] == 0
    squares, owner = errors[known] ** 2, recording[known]
    number = np.maximum(np.bincount(owner, minlength=count), 1)

    def mean(values: Array) -> Array:
        return np.maximum(np.bincount(owner, values, count) / number, 1e-300)

    square = mean(squares)
    for _ in range(TURNS):
        before, square = square, mean((NU + 1) * squares / (NU + squares / square[owner]))
        if (np.abs(square - before) <= SETTLED * before).all():
            break
    return square


@dataclass(frozen=True)
class Gain:
    """What one model predicts better than another.

    Attributes:
        total: log density gained [nat].
        error: its standard error, from the scatter between stretches [nat].
        chance: probability that nothing is gained.
    """

    total: float
    error: float
    chance: float

    def json(self) -> JSON:
        """Plain dictionary for JSON; no error where there is a single stretch."""
        error = self.error if np.isfinite(self.error) else None
        return {"total": self.total, "error": error, "chance": self.chance}


class Bootstrap:
    """Random weights of stretches (DRAWS, S), of mean one: those of a recording vary together, and each by itself."""

    def __init__(self, of_stretch: Index, rng: np.random.Generator) -> None:
        self.of_stretch = of_stretch
        recordings, own = np.unique(of_stretch, return_inverse=True)
        weights = rng.exponential(size=(DRAWS, len(of_stretch)))
        for k in range(len(recordings)):
            weights[:, own == k] /= weights[:, own == k].mean(axis=1, keepdims=True)
        if len(recordings) > 1:
            between = rng.exponential(size=(DRAWS, len(recordings)))
            weights *= (between / between.mean(axis=1, keepdims=True))[:, own]
        self.weights = weights

    def gain(self, after: Array, before: Array, penalty: float = 0.0) -> Gain:
        """Gain of one model over another from their log densities (S,).

        Args:
            after: of the one.
            before: of the other.
            penalty: what has to be gained for having chosen among many [nat].
        """
        difference = after - before
        draws = self.weights @ difference
        error = float(np.sqrt(len(difference)) * difference.std(ddof=1)) if len(difference) > 1 else np.inf
        return Gain(float(difference.sum()), error, float(np.mean(draws <= penalty)))

    def probabilities(self, densities: Sequence[Array]) -> Array:
        """Probability of each of several models (M,) from their log densities (S,) (pseudo-BMA+)."""
        totals = self.weights @ np.column_stack(densities)
        odds = np.exp(totals - totals.max(axis=1, keepdims=True))
        return np.asarray(np.mean(odds / odds.sum(axis=1, keepdims=True), axis=0))
