"""Online covariances under correlated errors: sums over short clusters of time.

theta - truth = P sum_k phi_k e_k. With the sums of a cluster, A = sum phi phi' and b = sum phi y, its score is
s = b - A theta, and the covariance is P (sum of s s') P, valid for correlated and filtered errors. As theta has
adapted to the cluster, s is too small: with J = 1 / P, leaving the cluster out would give J / (J - A) s, which is used.
As time goes on, neighbouring clusters are merged, so that there are always a few dozen; with forgetting, they stay
short against the memory and the oldest are dropped, their weights having fallen with the square. Directions without
data keep the variance of P(0). Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (jackknife).
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.online.kalman import KalmanLeastSquares
from estimators.online.recursion import SquareRootLeastSquares
from pendulum_env._typing import Array, Index, Mask

Recursion = SquareRootLeastSquares | KalmanLeastSquares


@dataclass(frozen=True)
class CovarianceSettings:
    """Numbers of the covariances; chosen for their coverage on simulated plants."""

    cluster: float = 0.2  # [s], the shortest, longer than the filters' memory
    most: int = 64  # clusters; at this number, neighbours are merged
    fewest: int = 10  # clusters beyond the number of parameters, below which the covariance is a rough guess
    share: float = 0.1  # of the memory that forgetting leaves, the longest a cluster may be
    guess: float = 60.0  # variance of a guess, in units of that of white errors


COVARIANCE = CovarianceSettings()


class Clusters:
    """Sums over clusters for (B, S) regressions with P parameters each."""

    def __init__(self, batch: tuple[int, int], parameters: int, period: float, forgetting: float) -> None:
        """Take the shape (B, S), the number of parameters, the time between samples [s] and the forgetting factor."""
        self._forgetting = forgetting
        self._longest = COVARIANCE.share / (1.0 - forgetting) if forgetting < 1 else np.inf
        self._shortest = max(2, round(min(COVARIANCE.cluster / period, self._longest)))
        self._left = np.zeros((COVARIANCE.most, *batch, parameters, parameters + 1))  # A and b
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

    def take(self, equations: Array, error: Array, usable: Mask) -> bool:
        """Take in one equation each, phi and y (B, S, P + 1); returns whether a cluster is complete."""
        np.multiply(equations, usable[..., None], out=self._rows[self._filled % self._shortest])
        self._used += usable
        self._filled += 1
        if self._filled % self._shortest == 0:
            self._now += np.einsum("r...i,r...j->...ij", self._rows[..., :-1], self._rows)
        return self._filled >= self._length

    def close(self, squares: Recursion) -> None:
        """Complete a cluster, given what has solved the regressions; one without equations is none."""
        if not self._used.any():
            self._filled = 0
            return
        theta, P = squares.theta, squares.P
        if self._forgetting < 1:
            self._left[: self._done] *= (self._forgetting**self._used)[..., None, None]
        self._left[self._done] = self._now
        self._done, self._filled = self._done + 1, 0
        learnt = self._used > 0
        self._now[:], self._used[:] = 0.0, 0.0
        if self._done == COVARIANCE.most and 2 * self._length <= self._longest:
            half = COVARIANCE.most // 2
            self._left[:half] = self._left[0::2] + self._left[1::2]
            self._left[half:] = 0.0
            self._done, self._length = half, 2 * self._length
        elif self._done == COVARIANCE.most:
            self._left[:-1, learnt] = self._left[1:, learnt]  # at rest, nothing is forgotten
            self._done -= 1
        left = self._left[: self._done]
        A, b = left[..., :-1], left[..., -1:]
        score = b - A @ theta[..., None]  # (clusters, B, S, P, 1)
        # J / (J - A) = 1 / (1 - A P); the last digit is for a cluster that holds all there is to know
        score = np.asarray(np.linalg.solve((1.0 + 1e-9) * np.eye(P.shape[-1]) - A @ P, score), dtype=float)
        self._meat = (score @ score.swapaxes(-1, -2)).sum(axis=0)
        self._known = np.count_nonzero(np.einsum("c...ii->c...", A), axis=0)

    def judge(self, squares: Recursion) -> Callable[[Array], Array]:
        """What turns P into a covariance now."""
        return functools.partial(_covariance, self._meat, self._known, squares.squares, squares.count, squares.prior)


def _covariance(meat: Array, known: Index, squares: Array, count: Array, prior: float, P: Array) -> Array:
    """Covariance of estimates (B, S, P, P) from the squares of scores, the clusters known, and P for unit noise."""
    parameters = P.shape[-1]
    spare = count - parameters
    noise = np.where(
        spare > 0, squares / np.maximum(spare, 1.0), 1.0 / COVARIANCE.guess
    )  # before any is seen, P(0) holds
    guess = COVARIANCE.guess * noise[..., None, None] * P
    correction = (known - 1) / np.maximum(known, 1)
    # the second part is what is not known of theta(0)
    judged = correction[..., None, None] * (P @ meat @ P) + (noise / prior)[..., None, None] * (P @ P)
    return np.where((known >= parameters + COVARIANCE.fewest)[..., None, None], judged, guess)


def wandered(walk: Array, theta: Array) -> Array:
    """How far parameters (..., P) may wander in a second: by a share of their value, or each in its own unit (P,)."""
    return walk if walk.ndim else walk * theta


class Wandering:
    """Covariances for random-walk parameters: P times the long-run variance of the errors of the last seconds.

    The P of a random-walk parameter has no clusters to compare. Errors that are correlated over a cluster of time have
    a long-run variance, mean (sum of a cluster)^2 / length, that is larger than their variance.
    """

    def __init__(self, batch: tuple[int, int], period: float, walk: Array | None = None) -> None:
        """Take the shape (B, S), the time between samples [s], and the random walk as `wandered` does, or none."""
        self._walk = np.zeros(()) if walk is None else walk
        self._length, self._filled = max(2, round(COVARIANCE.cluster / period)), 0
        self._now = np.zeros((2, *batch))  # sum and number of the errors in the cluster to come
        self._past = np.zeros((2, *batch))  # squares of such sums, and numbers, fading

    def reset(self, which: Mask) -> None:
        """Those of the B start anew."""
        self._now[:, which] = self._past[:, which] = 0.0

    def take(self, equations: Array, error: Array, usable: Mask) -> bool:
        """Take in a-priori errors (B, S), 0 where not usable; returns whether a cluster is complete."""
        self._now += np.array([error, usable])
        self._filled += 1
        return self._filled >= self._length

    def close(self, squares: Recursion | None = None) -> None:
        """Complete a cluster: the parameters may have moved since the last."""
        total, used = self._now
        share = np.where(used > 0, 1.0 / COVARIANCE.most, 0.0)  # at rest, nothing is forgotten
        self._past = (1.0 - share) * self._past + np.array([total**2, used])
        self._now, self._filled = np.zeros_like(self._now), 0
        if squares is not None:
            increase = wandered(self._walk, squares.theta) ** 2 * COVARIANCE.cluster
            squares.widen(increase / np.maximum(self.noise, np.finfo(float).tiny)[..., None])

    @property
    def noise(self) -> Array:
        """Long-run variance of the errors (B, S), one where none has been seen."""
        squares, count = self._past
        return np.where(count > 0, squares / np.maximum(count, 1.0), 1.0)

    def judge(self, squares: Recursion) -> Callable[[Array], Array]:
        """What turns P into a covariance now."""
        return functools.partial(np.multiply, self.noise[..., None, None])
