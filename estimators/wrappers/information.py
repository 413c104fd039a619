"""What a sample teaches: growth of the information that regressors carry, for many estimators at once."""

from __future__ import annotations

import numpy as np

from pendulum_env._typing import Array, Mask


class Information:
    """Information matrices sum phi phi' of B pendulums, from a small prior.

    Source: D-optimality, Fedorov, Theory of Optimal Experiments, 1972.
    """

    def __init__(self, prior: float) -> None:
        """Take the prior on the diagonal [regressor unit squared]: it keeps the first log det finite.

        Raises:
            ValueError: if it is not positive.
        """
        if not 0 < prior < np.inf:
            raise ValueError(f"the prior of the information cannot be {prior:g}: give a small positive number")
        self.prior = prior
        self.inverse = np.zeros((0, 0, 0))  # (B, P, P)

    def reset(self, batch: int, parameters: int, which: Mask | None = None) -> None:
        """Start anew, all or those of a mask (B,)."""
        fresh = np.eye(parameters) / self.prior
        if which is None or self.inverse.shape != (batch, parameters, parameters):
            self.inverse = np.tile(fresh, (batch, 1, 1))
        else:
            self.inverse[which] = fresh

    def gain(self, regressor: Array) -> Array:
        """Growth of log det(information) by one row each, (B, P) to (B,) [nat]."""
        raised = (self.inverse @ regressor[..., None])[..., 0]
        leverage = np.einsum("bi,bi->b", regressor, raised)  # matrix determinant lemma
        self.inverse -= raised[:, :, None] * (raised / (1.0 + leverage)[:, None])[:, None, :]
        return np.log1p(leverage)
