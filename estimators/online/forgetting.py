"""The running model with forgetting: what predicts better than the running model once its parameters have changed.

Recursions with exponential forgetting, of the parameters and of the scale of their errors, start from the running
model's fit. They predict by the mixture of several memories and the running model itself, weighted by their past
likelihoods. The running model in the mixture bounds what
forgetting loses while nothing changes. No weight falls below a share of the largest, so that a memory recovers at once.

Source: Herbster and Warmuth, Machine Learning 32, 1998 (mixtures that share); Ljung, System Identification, 2nd
edition, section 11.2 (forgetting).
"""

from collections.abc import Sequence

import numpy as np

from estimators.online.recursion import SquareRootLeastSquares
from estimators.regression.balance import LEAST_SLOPE
from estimators.selection.score import NU
from pendulum_env._typing import Array

LEAST_WEIGHT = -4.0  # log, relative to the largest


class Forgetting:
    """Recursions with forgetting, one per memory."""

    def __init__(self, theta: Array, root: Array, square: float, memories: Sequence[float]) -> None:
        """Start from a fit.

        Args:
            theta: parameters (P,).
            root: factor of their covariance for unit noise (P, P).
            square: squared scale of the errors.
            memories: time constants of forgetting [rows].
        """
        self._models = [
            SquareRootLeastSquares((1, 1), len(theta), forgetting=1.0 - 1.0 / max(rows, 2.0)) for rows in memories
        ]
        for model in self._models:
            model.theta, model.root = theta[None, None], root[None, None]
        self._memories = np.array(memories)
        self._square = np.full(len(memories), square)
        self._weight = np.full(1 + len(memories), LEAST_WEIGHT)  # of the running model and of each memory
        self._weight[0] = 0.0

    def take(self, phi: Array, slope: Array, passed: float, y: float, density: float) -> float:
        """Predict a row y = phi' theta, then learn from it.

        Args:
            phi: row (P,).
            slope: of phi by the torque (P,).
            passed: slope of y by the torque.
            y: left-hand side.
            density: log density of the row under the running model.

        Returns:
            Log density of the row under the mixture.
        """
        theta = np.array([model.theta[0, 0] for model in self._models])
        for model in self._models:
            model.take(phi[None, None], np.full((1, 1), y), np.ones((1, 1), dtype=bool))
        unsure = np.array([model.variance[0, 0] / model.forgetting for model in self._models])
        error = (y - theta @ phi) / np.maximum(passed - theta @ slope, LEAST_SLOPE)
        relative = error**2 / unsure
        scaled = NU * self._square
        each = -0.5 * np.log(self._square * unsure) - (NU + 1) / 2 * np.log1p(relative / scaled)
        self._square += ((NU + 1) / (NU + relative / self._square) * relative - self._square) / self._memories
        self._square = np.maximum(self._square, 1e-12)
        after = self._weight + np.concatenate([[density], each])
        mixed = float(np.logaddexp.reduce(after) - np.logaddexp.reduce(self._weight))
        self._weight = np.maximum(after - after.max(), LEAST_WEIGHT)
        return mixed
