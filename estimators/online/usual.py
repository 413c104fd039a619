"""Usual size of a model's errors, and significance of larger ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array


@dataclass(frozen=True)
class UsualSettings:
    """Numbers of what is usual; chosen on simulated plants by `benchmarks.watching`."""

    fewest: int = 3  # errors, before anything is usual
    prior: int = 4  # errors that what is known before any is worth
    scatter: float = 1.0  # standard deviation of the log of a mean square before any is known
    memory: int = 300  # errors, memory of the usual size
    most: float = 4.0  # standard deviations that an error counts for
    learnt: float = 2.0  # standard deviations that are learnt from one


USUAL = UsualSettings()


class Usual:
    """Distribution of log mean squared errors while a model holds: of blocks of rows or reversals, in Q units each.

    Attributes:
        mean: of the logs (Q,).
    """

    def __init__(self, units: int = 1) -> None:
        """Take Q; nothing is known yet."""
        self._learnt, self.mean, self._squares = 0, np.zeros(units), np.zeros(units)

    def learn(self, size: Array) -> None:
        """One more size (Q,) is usual."""
        bound = USUAL.learnt * self._scatter if self._learnt >= USUAL.fewest else np.inf
        step = np.clip(size - self.mean, -bound, bound)
        self._learnt = min(self._learnt + 1, USUAL.memory)
        share = 1.0 / self._learnt
        self.mean = self.mean + share * step
        kept = 1.0 if self._learnt < USUAL.memory else 1.0 - share
        self._squares = kept * (self._squares + (1.0 - share) * step**2)

    @property
    def _scatter(self) -> Array:
        return np.asarray(np.sqrt((USUAL.prior * USUAL.scatter**2 + self._squares) / (USUAL.prior + self._learnt - 1)))

    def surprise(self, sizes: Array) -> float:
        """By how many standard errors the mean of N sizes (N, Q) is larger than usual, in each of the units."""
        if self._learnt < USUAL.fewest:
            return 0.0
        new = np.clip((sizes - self.mean) / self._scatter, -USUAL.most, USUAL.most)
        return float(np.min(np.mean(new, axis=0)) / np.sqrt(1 / len(new) + 1 / self._learnt))
