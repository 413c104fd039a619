"""The one score: log predictive density of blocks of time that a model was not fitted to.

Each tenth of the blocks is predicted by the fit to the others; held-out recordings are predicted by the fit to all
training data. Residuals are taken as Student's t, since real errors have heavy tails. The density is always that of the
recorded torque, also if a law changes the torque before it reaches the joint. The gain of one model over another is the
sum of the differences, and its significance follows from their scatter: on a real machine no model is complete and
residuals are correlated for seconds, so only a gain that repeats from block to block and from recording to recording is
significant.

The scatter enters by the Bayesian bootstrap: random weights of blocks and of recordings, in many draws. The share of
draws without a gain is the p-value (`p_value`) of an effect; the mean softmax over competing models is the probability
of each (pseudo-BMA+).

Source: Vehtari, Gelman and Gabry, Statistics and Computing 27, 2017; Yao, Vehtari, Simpson and Gelman, Bayesian
Analysis 13(3), 2018; Rubin, Annals of Statistics 9(1), 1981; for the online form Dawid, JRSS A 147(2), 1984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from estimators.regression.balance import Balance
from estimators.regression.fold_fits import solve_without
from estimators.regression.least_squares import SOLVER
from pendulum_env._typing import JSON, Array, Index, Mask
from pendulum_env.physics.estimate import LARGEST
from pendulum_env.quantity import get_finite

BLOCK, FOLDS = 1.0, 10  # length of a block [s]; number of folds of cross-validation, to which blocks belong in turn
HELD_OUT = 0.3  # share of each recording, at its end, that is held out if no recording is
NU = 4.0  # degrees of freedom of Student's t
PEAK = float(np.exp(gammaln((NU + 1) / 2) - gammaln(NU / 2)) / np.sqrt(NU * np.pi))  # its density at zero
DRAWS = 4000  # of the Bayesian bootstrap
MAX_ITERATIONS, MIN_CHANGE = 20, 1e-3  # largest number of iterations for a scale; relative change at which they end
LEAP = 0.5  # longest step of Newton's method, in the logarithm of a squared scale


Hidden = Sequence[tuple[slice, float]]  # rows, and variance of the torque noise that a model removes from them


class Cells(NamedTuple):
    """Order of equations by cells: those of one recording and one fold.

    Attributes:
        order: indices of the equations, cell by cell (R,).
        begins: index in `order` at which each cell begins (C,).
        recording, fold: of each cell (C,).
        outside: for each left-out fold, numbers of equations by recording and fold, zero in that fold (FOLDS, E,
            FOLDS); of a recording with a single fold, its numbers.
    """

    order: Index
    begins: Index
    recording: Index
    fold: Index
    outside: Array


@dataclass(frozen=True)
class Blocks:
    """Blocks of R equations.

    Attributes:
        block: block of each equation (R,).
        recording: entry of each equation (R,), a recording or a recording of a joint.
        of_block: recording of each block (S,).
        piece: number of the piece of time of each equation (R,), by which equations belong to folds in turn.
        is_bounded: mask of equations (R,) with a bound of the error instead of noise, as in contact with a stop. The
            scale of the noise is that of the others. None if all have noise.
        least_scale: least scale of the errors, in the unit of the equations.
    """

    block: Index
    recording: Index
    of_block: Index
    piece: Index
    is_bounded: Mask | None = None
    least_scale: float = 0.0

    @cached_property
    def fold(self) -> Index:
        """Fold of each equation (R,)."""
        return np.asarray(self.piece % FOLDS)

    @cached_property
    def cells(self) -> Cells:
        """Cells of the equations with noise; of all equations of a recording that has none with noise."""
        cell = self.recording * FOLDS + self.fold
        order = np.argsort(cell, kind="stable")
        if self.is_bounded is not None:
            has_noise = np.bincount(self.recording, ~self.is_bounded) > 0
            order = order[(~self.is_bounded | ~has_noise[self.recording])[order]]
        filled, begins, counts = np.unique(cell[order], return_index=True, return_counts=True)
        recording, fold = np.divmod(filled, FOLDS)
        number = np.zeros((int(self.recording.max()) + 1, FOLDS))
        number[recording, fold] = counts
        others = number * (1.0 - np.eye(FOLDS))[:, None]
        outside = np.where(others.any(axis=2, keepdims=True), others, number)
        return Cells(order, begins, recording, fold, outside)


def compute_log_student(squares: Array, scale: Array | float) -> Array:
    """Return log densities of Student's t at squared errors, for a squared scale, without the constant [nat]."""
    return np.asarray(-0.5 * np.log(scale) - (NU + 1) / 2 * np.log1p(squares / (NU * scale)))


def weigh_squares(squares: Array, scale: Array | float) -> Array:
    """Return squared errors with the weights of Student's t; their mean is the next squared scale."""
    return np.asarray((NU + 1) * squares / (NU + squares / scale))


def cross_validate_density(
    balance: Balance, blocks: Blocks, hidden: Hidden = (), without: Array | None = None, removed: Array | float = 0.0
) -> Array:
    """Return the log density of each block (S,) [nat], predicted by the fits without each fold.

    `hidden` is torque noise that the model removes, which is added to the errors. `without` are the parameters of the
    fits (FOLDS, P), solved unless given. `removed` is the variance of encoder noise that it removes from each row (R,).
    """
    without = solve_without(balance, blocks.fold, FOLDS) if without is None else without
    return _compute_density(balance, without, blocks, hidden, removed)


def predict_density(
    theta: Array, balance: Balance, blocks: Blocks, hidden: Hidden = (), removed: Array | float = 0.0
) -> Array:
    """Return the log density of each held-out block (S,) under parameters (P,) fitted to other data [nat]."""
    return _compute_density(balance, theta[None], blocks, hidden, removed)


def _compute_density(balance: Balance, theta: Array, blocks: Blocks, hidden: Hidden, removed: Array | float) -> Array:
    """Return the log density of the recorded torque in each block (S,) [nat].

    `theta` are the parameters of the fits without each fold (FOLDS, P), or of one fit (1, P). The density of a residual
    is multiplied by its derivative by the recorded torque, so a law that transmits little torque has no gain. The
    derivative is raised to the density of a torque within `Balance.reach`. The scale is that of the other folds of the
    same recording.
    """
    residual, slopes = balance.residual(theta)
    residual = np.clip(residual, -LARGEST, LARGEST)
    for rows, variance in hidden:
        residual[:, rows] *= np.sqrt(1 + variance / max(float(np.mean(residual[:, rows] ** 2)), 1e-300))
    cell = np.minimum(blocks.fold, len(residual) - 1), np.arange(len(blocks.fold))
    reach = balance.reach
    least = np.maximum(SOLVER.tiny * np.where(np.isfinite(reach), reach, 0.0), blocks.least_scale)  # least scale
    squares = residual**2 + removed
    squared_scale = np.maximum(_estimate_scales(squares, blocks)[blocks.fold, blocks.recording], least**2)
    density = np.log(PEAK / np.sqrt(squared_scale)) - (NU + 1) / 2 * np.log1p(squares[cell] / (NU * squared_scale))
    least_slope = np.minimum(np.sqrt(squared_scale) / (PEAK * reach), 1.0)
    density += np.log(np.maximum(slopes[cell], least_slope))
    return np.bincount(blocks.block, density, len(blocks.of_block)).astype(float)


def _estimate_scales(squares: Array, blocks: Blocks) -> Array:
    """Return the squared scale of Student's t of the errors outside each fold, of each recording (FOLDS, E).

    `squares` are squared errors of the fits without each fold (FOLDS, R), or of one fit (1, R). A recording with errors
    in a single fold uses these. The maximum likelihood is found by Newton's method for the logarithm; a step above
    `LEAP` is replaced by one of the parameter-expanded EM algorithm (Liu, Rubin and Wu, Biometrika 85(4), 1998).
    """
    order, begins, owner, fold, counts = blocks.cells
    squares = squares[:, order]

    def sum_outside(values: Array) -> Array:
        """Return sums over the rows outside each fold (FOLDS, E)."""
        sums = np.zeros((len(values), *counts.shape[1:]))
        sums[:, owner, fold] = np.add.reduceat(values, begins, axis=1)
        return np.einsum("kef,kef->ke", np.broadcast_to(sums, counts.shape), counts > 0)

    count = np.maximum(counts.sum(axis=2), 1)
    most = np.maximum(sum_outside(squares) / count, 1e-300)  # upper limit of the squared scale
    scale, lengths = most, np.diff(np.append(begins, squares.shape[1]))
    for _ in range(MAX_ITERATIONS):
        share = squares / (NU * np.repeat(scale[:, owner], lengths, axis=1) + squares)
        excess = (NU + 1) * np.maximum(sum_outside(share) / count, 1e-300)  # one at the maximum
        step = (excess - 1.0) / np.maximum(excess - (NU + 1) * sum_outside(share**2) / count, 1e-300)
        safe = excess * NU / np.maximum(NU + 1 - excess, 1e-300)
        before, scale = scale, scale * np.where(np.abs(step) < LEAP, np.exp(np.clip(step, -LEAP, LEAP)), safe)
        scale = np.clip(scale, 1e-300, most)
        if (np.abs(scale - before) <= MIN_CHANGE * before).all():
            break
    return scale


@dataclass(frozen=True)
class Gain:
    """Gain in prediction of one model over another.

    Attributes:
        total: difference of the log densities [nat].
        error: standard error of `total`, by the bootstrap [nat]; infinite with a single block.
        p_value: probability that the gain is not above a penalty, by the bootstrap.
    """

    total: float
    error: float
    p_value: float

    def json(self) -> JSON:
        """Return a dictionary for JSON; an infinite error becomes null."""
        return {"total": self.total, "error": get_finite(self.error), "p_value": self.p_value}


class Bootstrap:
    """Random weights of blocks (DRAWS, S), of mean one: a factor for each recording times one for each block."""

    def __init__(self, of_block: Index, rng: np.random.Generator | None = None) -> None:
        """Draw weights of blocks with the recording of each (S,); by default with seed 0, once for equal blocks."""
        self.of_block = of_block
        self.weights = _draw_default_weights(*of_block.tolist()) if rng is None else _draw_weights(of_block, rng)

    def gain(self, after: Array, before: Array, penalty: float = 0.0) -> Gain:
        """Return the gain of a model over another, from the log densities of both, (S,) each.

        `penalty` is the gain that the choice among many models reaches by chance [nat]; the p-value is the share of
        draws at or below it.
        """
        difference = after - before
        draws = self.weights @ difference
        error = float(draws.std()) if len(difference) > 1 else np.inf
        p_value = float(np.mean(draws <= penalty)) if len(difference) > 1 else 1.0  # one block has no scatter
        return Gain(float(difference.sum()), error, p_value)

    def probabilities(self, densities: Sequence[Array]) -> Array:
        """Return the probability of each of M models (M,), from the log densities of each (S,), by pseudo-BMA+."""
        totals = self.weights @ np.column_stack(densities)
        odds = np.exp(totals - totals.max(axis=1, keepdims=True))
        return np.asarray(np.mean(odds / odds.sum(axis=1, keepdims=True), axis=0))


def _draw_weights(of_block: Index, rng: np.random.Generator) -> Array:
    """Draw the weights (DRAWS, S) of a bootstrap."""
    recordings, recording_of_block = np.unique(of_block, return_inverse=True)
    weights = rng.exponential(size=(DRAWS, len(of_block)))
    for k in range(len(recordings)):
        weights[:, recording_of_block == k] /= weights[:, recording_of_block == k].mean(axis=1, keepdims=True)
    if len(recordings) > 1:
        recording_weights = rng.exponential(size=(DRAWS, len(recordings)))
        weights *= (recording_weights / recording_weights.mean(axis=1, keepdims=True))[:, recording_of_block]
    return np.asarray(weights)


@lru_cache(maxsize=2)
def _draw_default_weights(*of_block: int) -> Array:
    """Draw the weights with seed 0; the joints of an arm have the same blocks."""
    weights = _draw_weights(np.array(of_block, dtype=np.intp), np.random.default_rng(0))
    weights.setflags(write=False)
    return weights
