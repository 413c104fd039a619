"""The one score: log predictive density of blocks of time that a model was not fitted to.

Each tenth of the blocks is predicted by the fit to the others; held-out recordings are predicted by the fit to all
training data. Residuals are taken as Student's t, since real errors have heavy tails, and the density is that of the
recorded torque, whatever its path to the joint. The gain of one model over another is the sum of the differences, and
its significance follows from their scatter: on a real machine no model is complete and residuals are correlated for
seconds, so only a gain that repeats from block to block and from recording to recording is significant.

The scatter enters by the Bayesian bootstrap: random weights of blocks and of recordings, in many draws. The share of
draws without a gain is the p-value (`p_value`) of an effect; the mean softmax over competing models is the probability
of each (pseudo-BMA+).

Source: Vehtari, Gelman and Gabry, Statistics and Computing 27, 2017; Yao, Vehtari, Simpson and Gelman, Bayesian
Analysis 13(3), 2018; Rubin, Annals of Statistics 9(1), 1981; for the online form Dawid, JRSS A 147(2), 1984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from estimators.data.rows import BLOCK, FOLDS, RowLayout
from estimators.regression.balance import Balance
from estimators.regression.least_squares import SOLVER
from pendulum_env._typing import JSON, Array, Index

NU = 4.0  # degrees of freedom of Student's t,
PEAK = float(np.exp(gammaln((NU + 1) / 2) - gammaln(NU / 2)) / np.sqrt(NU * np.pi))  # and its density at zero
DRAWS = 4000  # of the Bayesian bootstrap
TURNS, SETTLED = 20, 1e-3  # largest number of iterations for a scale, and relative change that the last may make
LEAP = 0.5  # longest step of Newton's method, in the logarithm of a squared scale


Hidden = Sequence[tuple[slice, float]]  # rows, and variance of the torque noise that a model absorbs in them


class Cells(NamedTuple):
    """Equations in an order in which those of a cell follow each other.

    Attributes:
        order: of the equations (R,).
        begins: where each cell begins in it (C,).
        recording, fold: of each cell (C,).
        outside: numbers of equations outside each fold by recording and fold (FOLDS, E, FOLDS), or of a recording's
            only fold.
    """

    order: Index
    begins: Index
    recording: Index
    fold: Index
    outside: Array


@dataclass(frozen=True)
class Blocks:
    """Block and recording of every equation (R,), and recording of every block (S,).

    Folds of cross-validation consist of pieces, numbered by `piece` (R,): whole blocks, or parts of them where the
    torque of one moment predicts the next.
    """

    block: Index
    recording: Index
    of_block: Index
    piece: Index

    @cached_property
    def fold(self) -> Index:
        """Fold of every equation (R,)."""
        return np.asarray(self.piece % FOLDS)

    @cached_property
    def cells(self) -> Cells:
        """Return the cells of the equations, of one recording and one fold each."""
        cell = self.recording * FOLDS + self.fold
        order = np.argsort(cell, kind="stable")
        filled, begins, counts = np.unique(cell[order], return_index=True, return_counts=True)
        recording, fold = np.divmod(filled, FOLDS)
        number = np.zeros((int(self.recording.max()) + 1, FOLDS))
        number[recording, fold] = counts
        others = number * (1.0 - np.eye(FOLDS))[:, None]
        outside = np.where(others.any(axis=2, keepdims=True), others, number)
        return Cells(order, begins, recording, fold, outside)


def make_blocks(layout: RowLayout, length: float = BLOCK) -> Blocks:
    """Return the blocks of some rows, with folds of pieces of a length [s]."""
    return Blocks(*layout.blocks(BLOCK), layout.blocks(length)[0])


def log_student(squares: Array, scale: Array | float) -> Array:
    """Return log densities of Student's t at squared errors, for a squared scale, without the constant [nat]."""
    return np.asarray(-0.5 * np.log(scale) - (NU + 1) / 2 * np.log1p(squares / (NU * scale)))


def weigh_squares(squares: Array, scale: Array | float) -> Array:
    """Return squared errors with the weights of Student's t; their mean is the next squared scale."""
    return np.asarray((NU + 1) * squares / (NU + squares / scale))


def cross_validated(balance: Balance, where: Blocks, hidden: Hidden = (), without: Array | None = None) -> Array:
    """Return the log density of each block (S,), predicted by the fit to the others [nat].

    Args:
        balance: equations of the model.
        where: block and recording of each equation.
        hidden: torque noise that the model absorbs, which still counts as error.
        without: parameters of the fits without each fold (FOLDS, P), solved unless given.
    """
    without = balance.solve_without(where.fold, FOLDS) if without is None else without
    return _compute_density(balance, without, where, hidden)


def predict_density(theta: Array, balance: Balance, where: Blocks, hidden: Hidden = ()) -> Array:
    """Return the log density of each held-out block (S,) under parameters (P,) fitted to other data [nat]."""
    return _compute_density(balance, theta[None], where, hidden)


def _compute_density(balance: Balance, theta: Array, where: Blocks, hidden: Hidden) -> Array:
    """Return the log density of the torque recorded in each block, from fits without each fold (FOLDS, P).

    It is the density of the residual times the derivative of the residual by the recorded torque, so that a law with a
    small residual only because it transmits little of the torque gains nothing. The density is at least that of a
    torque of known size alone. The scale is that of the other folds of the same recording, since recordings differ in
    their unexplained part.
    """
    left, slopes = balance.residual(theta)
    left = np.clip(left, -1e60, 1e60)  # [N m], against overflow of a prediction that diverged
    for rows, variance in hidden:
        left[:, rows] *= np.sqrt(1 + variance / max(float(np.mean(left[:, rows] ** 2)), 1e-300))
    own = np.minimum(where.fold, len(left) - 1), np.arange(len(where.fold))
    reach = balance.reach
    least = SOLVER.tiny * np.where(np.isfinite(reach), reach, 0.0)  # no torque is known better
    squares = left**2
    square = np.maximum(_estimate_scales(squares, where)[where.fold, where.recording], least**2)
    density = np.log(PEAK / np.sqrt(square)) - (NU + 1) / 2 * np.log1p(squares[own] / (NU * square))
    known = np.minimum(np.sqrt(square) / (PEAK * reach), 1.0)  # at least the density without any fit
    density += np.log(np.maximum(slopes[own], known))
    return np.bincount(where.block, density, len(where.of_block)).astype(float)


def _estimate_scales(squares: Array, where: Blocks) -> Array:
    """Return the squared scale of Student's t of the errors outside each fold, of each recording (FOLDS, E).

    By Newton's method for the logarithm, and by the parameter-expanded EM algorithm where that would leap (Liu, Rubin
    and Wu, Biometrika 85(4), 1998). `squares` are squared errors of the fits without each fold (FOLDS, R), or of one
    fit (1, R). A recording with errors in a single fold uses these.
    """
    order, begins, owner, fold, number = where.cells
    squares = squares[:, order]

    def total(values: Array) -> Array:
        """Return sums over the rows outside each fold (FOLDS, E)."""
        sums = np.zeros((len(values), *number.shape[1:]))
        sums[:, owner, fold] = np.add.reduceat(values, begins, axis=1)
        return np.einsum("kef,kef->ke", np.broadcast_to(sums, number.shape), number > 0)

    count = np.maximum(number.sum(axis=2), 1)
    most = np.maximum(total(squares) / count, 1e-300)  # the maximum is no larger, as x / (a + x) is concave
    square, lengths = most, np.diff(np.append(begins, squares.shape[1]))
    for _ in range(TURNS):
        share = squares / (NU * np.repeat(square[:, owner], lengths, axis=1) + squares)
        excess = (NU + 1) * np.maximum(total(share) / count, 1e-300)  # one at the maximum
        step = (excess - 1.0) / np.maximum(excess - (NU + 1) * total(share**2) / count, 1e-300)
        safe = excess * NU / np.maximum(NU + 1 - excess, 1e-300)
        before, square = square, square * np.where(np.abs(step) < LEAP, np.exp(np.clip(step, -LEAP, LEAP)), safe)
        square = np.clip(square, 1e-300, most)
        if (np.abs(square - before) <= SETTLED * before).all():
            break
    return square


@dataclass(frozen=True)
class Gain:
    """Gain in prediction of one model over another.

    Attributes:
        total: log density gained [nat].
        error: its standard error, from the scatter between blocks and between recordings, as `p_value` is [nat].
        p_value: probability of no gain.
    """

    total: float
    error: float
    p_value: float

    def json(self) -> JSON:
        """Return a dictionary for JSON; no error with a single block."""
        error = self.error if np.isfinite(self.error) else None
        return {"total": self.total, "error": error, "chance": self.p_value}


class Bootstrap:
    """Random weights of blocks (DRAWS, S), of mean one: a factor for each recording times one for each block."""

    def __init__(self, of_block: Index, rng: np.random.Generator) -> None:
        self.of_block = of_block
        recordings, own = np.unique(of_block, return_inverse=True)
        weights = rng.exponential(size=(DRAWS, len(of_block)))
        for k in range(len(recordings)):
            weights[:, own == k] /= weights[:, own == k].mean(axis=1, keepdims=True)
        if len(recordings) > 1:
            between = rng.exponential(size=(DRAWS, len(recordings)))
            weights *= (between / between.mean(axis=1, keepdims=True))[:, own]
        self.weights = weights

    def gain(self, after: Array, before: Array, penalty: float = 0.0) -> Gain:
        """Return the gain of one model over another from their log densities (S,).

        Args:
            after: densities of the one.
            before: densities of the other.
            penalty: least gain, for the choice among many models [nat].
        """
        difference = after - before
        draws = self.weights @ difference
        error = float(draws.std()) if len(difference) > 1 else np.inf
        return Gain(float(difference.sum()), error, float(np.mean(draws <= penalty)))

    def probabilities(self, densities: Sequence[Array]) -> Array:
        """Return the probability of each of several models (M,) from their log densities (S,) (pseudo-BMA+)."""
        totals = self.weights @ np.column_stack(densities)
        odds = np.exp(totals - totals.max(axis=1, keepdims=True))
        return np.asarray(np.mean(odds / odds.sum(axis=1, keepdims=True), axis=0))
