"""Mixture of models with forgetting, which predicts better than the running model after parameters have changed.

Recursions with exponential forgetting of parameters and error scale start from the fit of the running model. The
mixture of several memories and the running model is weighted by past likelihoods. The running model in the mixture
bounds the loss while nothing changes. No weight falls below a share of the largest, so a memory recovers at once.

Source: Herbster and Warmuth, Machine Learning 32, 1998 (mixtures that share); Ljung, System Identification, 2nd
edition, section 11.2 (forgetting).
"""

from collections.abc import Sequence

import numpy as np

from estimators.online.binning import ModelRows
from estimators.online.recursion import SquareRootLeastSquares
from estimators.regression.balance import LEAST_SLOPE
from estimators.selection.score import log_student, weigh_squares
from pendulum_env._typing import Array

LEAST_WEIGHT = -4.0  # log, relative to the largest


def cap_density(density: Array, error_slope: Array, reference: Array | float) -> Array:
    """Cap log densities at that of a reference where `error_slope` is below `LEAST_SLOPE`.

    `error_slope` is the derivative of the equation error by the torque. A law that makes it small passes almost none of
    the torque, so its errors are small for that reason alone.
    """
    return np.where(error_slope < LEAST_SLOPE, np.minimum(density, reference), density)


class ForgettingMixture:
    """Recursions with forgetting, one per memory."""

    def __init__(self, theta: Array, root: Array, square: float, memories: Sequence[float]) -> None:
        """Start from a fit theta (P,) with a root of its unit covariance (P, P) and the squared scale of its errors.

        The memories are time constants of forgetting [rows].
        """
        self._models = [
            SquareRootLeastSquares((1, 1), len(theta), forgetting=1.0 - 1.0 / max(rows, 2.0)) for rows in memories
        ]
        for model in self._models:
            model.theta, model.root = theta[None, None], root[None, None]
        self._memories = np.array(memories)
        self._square = np.full(len(memories), square)  # squared error scales
        self._weight = np.full(1 + len(memories), LEAST_WEIGHT)  # log, of the running model and of each memory
        self._weight[0] = 0.0

    def take(self, row: ModelRows, density: float) -> float:
        """Predict a row (P,), then learn from it; return its log density under the mixture.

        `density` is its log density under the running model.
        """
        theta = np.array([model.theta[0, 0] for model in self._models])
        for model in self._models:
            model.take(row.phi[None, None], np.full((1, 1), row.y), np.ones((1, 1), dtype=bool))
        variance_ratio = np.array([model.variance[0, 0] / model.forgetting for model in self._models])
        errors, error_slope = row.predict(theta)
        squares = errors**2
        densities = cap_density(log_student(squares, self._square * variance_ratio), error_slope, density)
        self._square += (weigh_squares(squares / variance_ratio, self._square) - self._square) / self._memories
        self._square = np.maximum(self._square, 1e-12)
        weight = self._weight + np.concatenate([[density], densities])
        mixture_density = float(np.logaddexp.reduce(weight) - np.logaddexp.reduce(self._weight))
        self._weight = np.maximum(weight - weight.max(), LEAST_WEIGHT)
        return mixture_density
