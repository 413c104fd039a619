"""Evidence that adds up while it lasts: a CUSUM of each of B models."""

from __future__ import annotations

import numpy as np

from pendulum_env._typing import Array, Index, Mask


class Cusum:
    """Sums of evidence, and what was the case when there was none.

    Attributes:
        value: of the sums (B,) [nat].
        since: moment at which they were last zero (B,).
        theta: parameters then (B, P).
        root: factor of their P (B, P, P).
    """

    def __init__(self, batch: int, size: int) -> None:
        """Take B and P."""
        self.value, self.since = np.zeros(batch), np.zeros(batch, dtype=np.intp)
        self.theta, self.root = np.zeros((batch, size)), np.zeros((batch, size, size))

    def add(self, gain: Array, due: Mask, moment: Index, theta: Array, root: Array) -> None:
        """Add gains (B,) of those that are due, at a moment (B,) and with the parameters there are, as `begin`."""
        grown = self.value + np.where(due, gain, 0.0)
        self.begin(due & (grown <= 0), moment, theta, root)
        self.value = np.maximum(grown, 0.0)

    def begin(self, which: Mask, moment: Index, theta: Array, root: Array) -> None:
        """Those of the B have no evidence at a moment, with such parameters."""
        self.value = np.where(which, 0.0, self.value)
        self.since = np.where(which, moment, self.since)
        self.theta = np.where(which[:, None], theta, self.theta)
        self.root = np.where(which[:, None, None], root, self.root)
