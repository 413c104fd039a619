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
        """Create the sums for a period between equations [s] and the forgetting factor of the recursion."""
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

    def make_covariance(self, squares: Recursion) -> Callable[[], tuple[Array, Array]]:
        """Return a function that computes P and the covariance of now, also later."""
        state = squares.squares, squares.count, squares.prior
        return functools.partial(_compute_covariances, squares.unit_covariance(), self._meat, self._known, *state)


def _compute_covariances(
    unit: Callable[[], Array], meat: Array, known: Index, squares: Array, count: Array, prior: float
) -> tuple[Array, Array]:
    """Compute P and covariance of estimates (B, S, P, P) from squares of scores and number of clusters."""
    P = unit()
    parameters = P.shape[-1]
    spare = count - parameters
    # before the first equations, the covariance is P(0)
    noise = np.where(spare > 0, squares / np.maximum(spare, 1.0), 1.0 / COVARIANCE.guess_variance)
    guess = COVARIANCE.guess_variance * noise[..., None, None] * P
    correction = (known - 1) / np.maximum(known, 1)
    # the second part is the variance of theta(0)
    robust = correction[..., None, None] * (P @ meat @ P) + (noise / prior)[..., None, None] * (P @ P)
    is_robust = known >= parameters + COVARIANCE.min_extra_clusters
    return P, np.where(is_robust[..., None, None], robust, guess)
