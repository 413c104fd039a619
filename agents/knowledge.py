"""What an online estimator knows of a plant while the torque is being chosen, tick by tick.

Everything is in nominal units: parameters as shares of the nominal ones, so that x = 1 is the nominal plant, and rows
as the torque that each nominal parameter takes. Knowledge is that of Bayes from a prior around the nominal plant:

    M = M0 + sum phi phi'        information, P times P, in units of the noise
    x = M^-1 (M0 1 + sum phi y)  estimates
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.plant import PAPER

NOMINAL = np.array(list(PAPER.values()))  # inertia, gravity, viscous, coulomb
SLOW = 0.2  # [rad/s]; slower than this nothing is learnt: near stick information rises and real errors do not fall
PRIOR = 0.1  # of the information: (noise / spread)^2 with 0.1 N m of noise on a tick and plants within some 30 %
DECADES = 10.0  # by which log information is divided, for it to be about 1 in the end
COUNT = len(NOMINAL)
PAIRS: tuple[Index, Index] = np.triu_indices(COUNT, 1)
FEATURES = 2 * COUNT + len(PAIRS[0])


@dataclass(eq=False)
class Knowledge:
    """Knowledge of B plants."""

    information: Array  # M (B, P, P)
    moment: Array  # M0 1 + sum phi y (B, P)

    @classmethod
    def none(cls, batch: int) -> Knowledge:
        """That of the prior."""
        return cls(np.tile(PRIOR * np.eye(COUNT), (batch, 1, 1)), np.full((batch, COUNT), PRIOR))

    def take(self, rows: Array, torque: Array, usable: Mask) -> None:
        """Take in one equation of each plant: rows (B, P) in nominal units, torque (B,) [N m], where usable (B,)."""
        rows = rows * usable[:, None]
        self.information = self.information + rows[:, :, None] * rows[:, None, :]
        self.moment = self.moment + rows * torque[:, None]

    @property
    def estimates(self) -> Array:
        """Parameters as shares of the nominal ones (B, P)."""
        return np.asarray(np.linalg.solve(self.information, self.moment[..., None])[..., 0], dtype=np.float64)

    def features(self) -> Array:
        """Log information of each parameter, correlations, deviation of the estimates from nominal (B, FEATURES)."""
        diagonal = np.einsum("bii->bi", self.information)
        scale = np.sqrt(diagonal)
        correlations = (self.information / scale[:, :, None] / scale[:, None, :])[:, PAIRS[0], PAIRS[1]]
        return np.concatenate([np.log(diagonal / PRIOR) / DECADES, correlations, self.estimates - 1.0], axis=1)


def log_det(information: Array) -> Array:
    """Logarithm of determinants (...) of (..., P, P) [nat]: what D-optimality counts (Fedorov 1972)."""
    return np.linalg.slogdet(information).logabsdet


def recall(features: Array) -> tuple[Array, Array]:
    """Information (B, P, P) and estimates as shares (B, P) that features tell of."""
    scale = np.sqrt(PRIOR * np.exp(DECADES * features[:, :COUNT].astype(float)))
    correlations = np.tile(np.eye(COUNT), (len(features), 1, 1))
    upper = features[:, COUNT:-COUNT]
    correlations[:, PAIRS[0], PAIRS[1]] = upper
    correlations[:, PAIRS[1], PAIRS[0]] = upper
    return correlations * scale[:, :, None] * scale[:, None, :], 1.0 + features[:, -COUNT:].astype(float)
