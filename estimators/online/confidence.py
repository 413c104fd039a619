"""Online covariances of estimates under correlated errors, from sums over short clusters of time.

theta - truth = P sum_k phi_k e_k. With the sums of a cluster, A = sum phi phi' and b = sum phi y, its score is
s = b - A theta, and the covariance is P (sum of s s') P, valid for correlated and filtered errors. Since theta was
fitted to the cluster, s is too small; the score J / (J - A) s of a fit without the cluster, with J = 1 / P, is used.
Neighbouring clusters are merged as time passes, so that there are always a few dozen. With forgetting, clusters stay
short against the memory, and the oldest ones are dropped. Directions without data keep the variance of P(0).

Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (jackknife).
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from estimators.online.recursion import Recursion
from pendulum_env._typing import Array, Index, Mask


@dataclass(frozen=True)
class CovarianceSettings:
    """Settings of the covariances, chosen by their coverage on simulated plants."""

    cluster_time: float = 0.2  # [s], shortest duration, longer than the memory of filters
    max_clusters: int = 64  # at this number, neighbours are merged
    min_extra_clusters: int = 10  # clusters beyond the number of parameters that a covariance needs
    max_memory_share: float = 0.1  # longest duration relative to the memory of forgetting
    guess_variance: float = 60.0  # variance relative to white errors while there are few clusters


COVARIANCE = CovarianceSettings()


class ClusterCovariance:
    """Sums over clusters for (B, S) regressions with P parameters each."""

    def __init__(self, batch: tuple[int, int], parameters: int, period: float, forgetting: float) -> None:
        """Create the sums.

        Args:
            batch: shape (B, S).
            parameters: number P of parameters.
            period: between equations [s].
            forgetting: factor of the recursion.
        """
        self._forgetting = forgetting
        self._longest = COVARIANCE.max_memory_share / (1.0 - forgetting) if forgetting < 1 else np.inf
        self._shortest = max(2, round(min(COVARIANCE.cluster_time / period, self._longest)))
        self._clusters = np.zeros((COVARIANCE.max_clusters, *batch, parameters, parameters + 1))  # A and b
        self._now = np.zeros((*batch, parameters, parameters + 1))  # of the current cluster, without
        self._rows = np.zeros((self._shortest, *batch, parameters + 1))  # its last equations
        self._used = np.zeros(batch)  # equations in the current cluster
        self._meat = np.zeros((*batch, parameters, parameters))
        self._known = np.zeros(batch, dtype=int)  # clusters with equations
        self._length, self._filled, self._done = self._shortest, 0, 0

    def reset(self, which: Mask) -> None:
        """Restart plants (B,); the others keep their clusters."""
        self._clusters[:, which] = 0.0
        self._rows[:, which] = 0.0
        # covariance functions in use keep the old arrays
        self._meat, self._known = self._meat.copy(), self._known.copy()
        for series in (self._now, self._used, self._meat, self._known):
            series[which] = 0
        if which.all():
            self._length, self._filled, self._done = self._shortest, 0, 0

    def take(self, equations: Array, error: Array, usable: Mask) -> bool:
        """Add an equation each, phi and y (B, S, P + 1); return whether the cluster is complete."""
        np.multiply(equations, usable[..., None], out=self._rows[self._filled % self._shortest])
        self._used += usable
        self._filled += 1
        if self._filled % self._shortest == 0:
            self._now += np.einsum("r...i,r...j->...ij", self._rows[..., :-1], self._rows)
        return self._filled >= self._length

    def close(self, squares: Recursion) -> None:
        """Complete the cluster with the current estimates; a cluster without equations is dropped."""
        if not self._used.any():
            self._filled = 0
            return
        theta, P = squares.theta, squares.P
        if self._forgetting < 1:
            self._clusters[: self._done] *= (self._forgetting**self._used)[..., None, None]
        self._clusters[self._done] = self._now
        self._done, self._filled = self._done + 1, 0
        learnt = self._used > 0
        self._now[:], self._used[:] = 0.0, 0.0
        if self._done == COVARIANCE.max_clusters and 2 * self._length <= self._longest:
            half = COVARIANCE.max_clusters // 2
            self._clusters[:half] = self._clusters[0::2] + self._clusters[1::2]
            self._clusters[half:] = 0.0
            self._done, self._length = half, 2 * self._length
        elif self._done == COVARIANCE.max_clusters:
            self._clusters[:-1, learnt] = self._clusters[1:, learnt]  # at rest, nothing is forgotten
            self._done -= 1
        A, b = np.split(self._clusters[: self._done], [-1], axis=-1)
        score = b - A @ theta[..., None]  # (clusters, B, S, P, 1)
        # J / (J - A) = 1 / (1 - A P); 1e-9 is for a cluster with all the information
        score = np.asarray(np.linalg.solve((1.0 + 1e-9) * np.eye(P.shape[-1]) - A @ P, score), dtype=float)
        self._meat = (score @ score.swapaxes(-1, -2)).sum(axis=0)
        self._known = np.count_nonzero(np.einsum("c...ii->c...", A), axis=0)

    def scale_covariance(self, squares: Recursion) -> Callable[[Array], Array]:
        """Return the function that converts P into the current covariance."""
        return functools.partial(_covariance, self._meat, self._known, squares.squares, squares.count, squares.prior)


def _covariance(meat: Array, known: Index, squares: Array, count: Array, prior: float, P: Array) -> Array:
    """Compute the covariance of estimates (B, S, P, P) from squares of scores, number of clusters, and unit P."""
    parameters = P.shape[-1]
    spare = count - parameters
    # before the first equations, the covariance is P(0)
    noise = np.where(spare > 0, squares / np.maximum(spare, 1.0), 1.0 / COVARIANCE.guess_variance)
    guess = COVARIANCE.guess_variance * noise[..., None, None] * P
    correction = (known - 1) / np.maximum(known, 1)
    # the second part is the variance of theta(0)
    robust = correction[..., None, None] * (P @ meat @ P) + (noise / prior)[..., None, None] * (P @ P)
    return np.where((known >= parameters + COVARIANCE.min_extra_clusters)[..., None, None], robust, guess)


def random_walk_std(walk: Array, theta: Array) -> Array:
    """Return the standard deviation of a random walk in a second: relative to theta (..., P), or in its unit (P,)."""
    return walk if walk.ndim else walk * theta


class RandomWalkCovariance:
    """Covariances of random-walk parameters: P times the long-run variance of the errors of the last seconds.

    For errors that are correlated over a cluster of time, the long-run variance, mean (sum of a cluster)^2 / length, is
    larger than the variance.
    """

    def __init__(self, batch: tuple[int, int], period: float, walk: Array | None = None) -> None:
        """Take the shape (B, S), the time between samples [s], and the random walk as `wandered` does, or none."""
        self._walk = np.zeros(()) if walk is None else walk
        self._length, self._filled = max(2, round(COVARIANCE.cluster_time / period)), 0
        self._now = np.zeros((2, *batch))  # sum and number of the errors in the current cluster
        self._past = np.zeros((2, *batch))  # squares of these sums, and numbers, with forgetting

    def reset(self, which: Mask) -> None:
        """Restart plants (B,)."""
        self._now[:, which] = self._past[:, which] = 0.0

    def take(self, equations: Array, error: Array, usable: Mask) -> bool:
        """Add a-priori errors (B, S), 0 where not usable; return whether the cluster is complete."""
        self._now += np.array([error, usable])
        self._filled += 1
        return self._filled >= self._length

    def close(self, squares: Recursion | None = None) -> None:
        """Complete the cluster, and add the random walk of its duration to P."""
        total, used = self._now
        share = np.where(used > 0, 1.0 / COVARIANCE.max_clusters, 0.0)  # at rest, nothing is forgotten
        self._past = (1.0 - share) * self._past + np.array([total**2, used])
        self._now, self._filled = np.zeros_like(self._now), 0
        if squares is not None:
            increase = random_walk_std(self._walk, squares.theta) ** 2 * COVARIANCE.cluster_time
            squares.inflate(increase / np.maximum(self.noise, np.finfo(float).tiny)[..., None])

    @property
    def noise(self) -> Array:
        """Compute the long-run variance of the errors (B, S); 1 without errors."""
        squares, count = self._past
        return np.where(count > 0, squares / np.maximum(count, 1.0), 1.0)

    def scale_covariance(self, squares: Recursion) -> Callable[[Array], Array]:
        """Return the function that converts P into the current covariance."""
        return functools.partial(np.multiply, self.noise[..., None, None])
