"""Honest covariances online: equations come in short clusters of time, within which errors may be correlated.

theta - truth = P sum_k phi_k e_k. With the sums of a cluster, A = sum phi phi' and b = sum phi y, its score is
s = b - A theta, and the covariance is P (sum of s s') P: it knows correlated errors and those of a filter. As theta has
adapted to the cluster, s is too small: with J = 1 / P, leaving the cluster out would give J / (J - A) s, which is used.
As time goes on, neighbouring clusters are merged, so that there are always a few dozen. Forgetting makes the weights of
older clusters fall with the square, as it must. Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (jackknife).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array, Index, Mask

CLUSTER = 0.2  # [s], the shortest, longer than the filters' memory
MOST = 64  # clusters; at this number, neighbours are merged
FEWEST = 10  # beyond the parameters, before which the covariance is a rough guess
GUESS = 60.0  # variance of a guess, in units of that of white errors


class Clusters:
    """Sums over clusters for (B, S) regressions with P parameters each."""

    def __init__(self, batch: tuple[int, int], parameters: int, period: float) -> None:
        """Take the shape (B, S), the number of parameters and the time between samples [s]."""
        self._shortest = max(2, round(CLUSTER / period))
        self._left = np.zeros((MOST, *batch, parameters, parameters + 1))  # A and b
        self._now = np.zeros((*batch, parameters, parameters + 1))  # of the cluster to come, but for
        self._rows = np.zeros((self._shortest, *batch, parameters + 1))  # its last equations, not yet summed
        self._used = np.zeros(batch)  # equations in the cluster to come
        self._meat = np.zeros((*batch, parameters, parameters))
        self._known = np.zeros(batch, dtype=int)  # clusters that hold equations
        self._length, self._filled, self._done = self._shortest, 0, 0

    def reset(self, which: Mask) -> None:
        """Those of the B start anew; the others keep their clusters."""
        self._left[:, which] = 0.0
        self._rows[:, which] = 0.0
        self._meat, self._known = self._meat.copy(), self._known.copy()  # judges keep the old ones
        for series in (self._now, self._used, self._meat, self._known):
            series[which] = 0
        if which.all():
            self._length, self._filled, self._done = self._shortest, 0, 0

    def take(self, phi: Array, y: Array, usable: Mask) -> bool:
        """Take in one equation each, phi (B, S, P), y (B, S); returns whether a cluster is complete."""
        row = self._rows[self._filled % self._shortest]
        row[..., :-1], row[..., -1] = phi, y
        row *= usable[..., None]
        self._used += usable
        self._filled += 1
        if self._filled % self._shortest == 0:
            self._now += np.einsum("r...i,r...j->...ij", self._rows[..., :-1], self._rows)
        return self._filled >= self._length

    def seconds(self, rate: float) -> float:
        """Length of a cluster now [s]."""
        return self._length / rate

    def fade(self, share: Array) -> None:
        """Multiply all sums so far by a matrix (B, S, P, P): what is left of them in the inverse of P."""
        self._left[: self._done] = share @ self._left[: self._done]

    def close(self, theta: Array, P: Array, forgetting: float) -> None:
        """Complete a cluster.

        Args:
            theta: estimates (B, S, P).
            P: their covariance for unit noise (B, S, P, P).
            forgetting: factor for every equation that was used.
        """
        if forgetting < 1:
            self._left[: self._done] *= (forgetting**self._used)[..., None, None]
        self._left[self._done] = self._now
        self._done, self._filled = self._done + 1, 0
        self._now[:], self._used[:] = 0.0, 0.0
        if self._done == MOST:
            half = MOST // 2
            self._left[:half] = self._left[0::2] + self._left[1::2]
            self._left[half:] = 0.0
            self._done, self._length = half, 2 * self._length
        left = self._left[: self._done]
        A, b = left[..., :-1], left[..., -1:]
        score = b - A @ theta[..., None]  # (clusters, B, S, P, 1)
        # J / (J - A) = 1 / (1 - A P)
        score = np.asarray(np.linalg.solve(np.eye(P.shape[-1]) - A @ P, score), dtype=float)
        self._meat = (score @ score.swapaxes(-1, -2)).sum(axis=0)
        self._known = np.count_nonzero(np.einsum("c...ii->c...", A), axis=0)

    def judge(self, squares: Array, count: Array) -> Judge:
        """What turns P into a covariance now, for sums of squared errors and counts of equations (B, S)."""
        return Judge(self._meat, self._known, squares, count)


@dataclass(frozen=True, eq=False)
class Judge:
    """Covariance of estimates from their P for unit noise, as of one moment."""

    meat: Array  # sum of the squares of scores (B, S, P, P)
    known: Index  # clusters that hold equations (B, S)
    squares: Array  # sum of squared errors (B, S)
    count: Array  # equations (B, S)

    def __call__(self, P: Array) -> Array:
        """Covariance (B, S, P, P)."""
        parameters = P.shape[-1]
        spare = self.count - parameters
        noise = np.where(
            spare > 0, GUESS * self.squares / np.maximum(spare, 1.0), 1.0
        )  # unit noise, before any is seen
        guess = noise[..., None, None] * P
        known = self.known >= parameters + FEWEST
        correction = (self.known - 1) / np.maximum(self.known, 1)
        return np.where(known[..., None, None], correction[..., None, None] * (P @ self.meat @ P), guess)
