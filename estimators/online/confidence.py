"""Online covariances of estimates under correlated errors, from sums over short clusters of time.

theta - truth = P sum_k phi_k e_k. With the sums of a cluster, A = sum phi phi' and b = sum phi y, its score is
s = b - A theta, and the covariance is P (sum of s s') P, valid for correlated and filtered errors. Since theta was
fitted to the cluster, s is too small; the score J / (J - A) s of a fit without the cluster, with J = 1 / P, is used.
Neighbouring clusters are merged as time passes, so that there are always a few dozen. With forgetting, clusters stay
short against the memory, and the oldest ones are dropped. Directions without data keep the variance of P(0).

Noise of the encoder is also in phi, which biases least squares. The sums of equations with added noise of the same
variance show the bias: D and d are their mean for noise and its negative, minus A and b. Sums A - D and b - d are
those without noise to second order, for any scheme and any term. The estimate is corrected by their solution.

Sources: Bell and McCaffrey, Survey Methodology 28(2), 2002 (jackknife); Cook and Stefanski, Journal of the American
Statistical Association 89, 1994 (extrapolation of added noise).
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
    max_noise_share: float = 0.5  # largest share of information that is subtracted as noise
    noise_uncertainty: float = 0.3  # of the variance of the encoder noise, relative


COVARIANCE = CovarianceSettings()


class ClusterCovariance:
    """Sums over clusters for (B, S) regressions with P parameters each.

    Attributes:
        correction: of theta for the bias by encoder noise (B, S, P).
    """

    def __init__(
        self, batch: tuple[int, int], parameters: int, period: float, forgetting: float, n_copies: int
    ) -> None:
        """Create the sums.

        Args:
            batch: (B, S).
            parameters: their number P.
            period: between equations [s].
            forgetting: factor of the recursion.
            n_copies: number C of copies of the equations, see `StreamEquations`.
        """
        self._forgetting = forgetting
        self._max_length = COVARIANCE.max_memory_share / (1.0 - forgetting) if forgetting < 1 else np.inf
        self._min_length = max(2, round(min(COVARIANCE.cluster_time / period, self._max_length)))
        copies = (n_copies, *batch)
        # sums of products of phi and y: A and b, and b' and y'y in the last row
        self._clusters = np.zeros((COVARIANCE.max_clusters, *copies, parameters + 1, parameters + 1))
        self._current = np.zeros((*copies, parameters + 1, parameters + 1))  # of the cluster, without `_rows`
        self._rows = np.zeros((self._min_length, *copies, parameters + 1))  # its last equations
        self._n_used = np.zeros(batch)  # usable equations in the current cluster
        self.correction = np.zeros((*batch, parameters))
        self._scores, self._bias = np.zeros((2, *batch, parameters, parameters))
        self._n_clusters = np.zeros(batch, dtype=int)  # clusters with equations
        self._length, self._n_rows, self._n_closed = self._min_length, 0, 0

    def reset(self, which: Mask) -> None:
        """Restart plants (B,); the others keep their clusters."""
        self._clusters[:, :, which] = self._rows[:, :, which] = self._current[:, which] = 0.0
        # covariance functions in use keep the old arrays
        self._scores, self._bias, self._n_clusters = self._scores.copy(), self._bias.copy(), self._n_clusters.copy()
        for series in (self._n_used, self._scores, self._n_clusters, self._bias, self.correction):
            series[which] = 0
        if which.all():
            self._length, self._n_rows, self._n_closed = self._min_length, 0, 0

    def take(self, copies: Array, usable: Mask) -> bool:
        """Add one equation of each regression, phi and y (C, B, S, P + 1), where usable (B, S).

        Returns:
            True if the current cluster is long enough to be closed.
        """
        np.multiply(copies, usable[..., None], out=self._rows[self._n_rows % self._min_length])
        self._n_used += usable
        self._n_rows += 1
        if self._n_rows % self._min_length == 0:
            self._current += np.einsum("r...i,r...j->...ij", self._rows, self._rows)
        return self._n_rows >= self._length

    def close(self, squares: Recursion) -> None:
        """Close the current cluster; compute the correction, and the scores of all clusters at corrected estimates.

        A cluster without equations is dropped; others lower the weight of the earlier clusters by forgetting. At
        `max_clusters`, neighbours are merged, or the oldest is dropped.
        """
        if not self._n_used.any():
            self._n_rows = 0
            return
        theta, P = squares.theta, squares.P
        if self._forgetting < 1:
            self._clusters[: self._n_closed] *= (self._forgetting**self._n_used)[..., None, None]
        self._clusters[self._n_closed] = self._current
        self._n_closed, self._n_rows = self._n_closed + 1, 0
        has_equations = self._n_used > 0
        self._current[:], self._n_used[:] = 0.0, 0.0
        if self._n_closed == COVARIANCE.max_clusters and 2 * self._length <= self._max_length:
            half = COVARIANCE.max_clusters // 2
            self._clusters[:half] = self._clusters[0::2] + self._clusters[1::2]
            self._clusters[half:] = 0.0
            self._n_closed, self._length = half, 2 * self._length
        elif self._n_closed == COVARIANCE.max_clusters:
            # at rest, nothing is forgotten
            self._clusters[:-1, :, has_equations] = self._clusters[1:, :, has_equations]
            self._n_closed -= 1
        sums = self._clusters[: self._n_closed, 0]
        if self._clusters.shape[1] > 1:
            excess = self._clusters[: self._n_closed, 1:].mean(axis=1) - sums
            sums = sums - self._correct(sums.sum(axis=0), excess.sum(axis=0), theta, P) * excess
            theta = theta + self.correction
        A, b = np.split(sums[..., :-1, :], [-1], axis=-1)
        score = b - A @ theta[..., None]  # (clusters, B, S, P, 1)
        # J / (J - A) = 1 / (1 - A P); 1e-9 is for a cluster with all the information
        score = np.asarray(np.linalg.solve((1.0 + 1e-9) * np.eye(P.shape[-1]) - A @ P, score), dtype=float)
        self._scores = (score @ score.swapaxes(-1, -2)).sum(axis=0)
        self._n_clusters = np.count_nonzero(np.einsum("c...ii->c...", A), axis=0)

    def _correct(self, total: Array, excess: Array, theta: Array, P: Array) -> Array:
        """Compute the correction of theta from sums as measured, and their excess by noise (B, S, P + 1, P + 1).

        Noise that explains more than the residual was taken too large, and is scaled down.

        Returns:
            The share of the excess that is subtracted (B, S, 1, 1).
        """
        errors = np.append(-theta, np.ones((*theta.shape[:-1], 1)), axis=-1)  # the residual is its product with rows
        residual, noise = (np.einsum("...i,...ij,...j", errors, part, errors) for part in (total, excess))
        scale = np.minimum(1.0, residual / np.maximum(noise, 1e-300))[..., None, None]
        D, d = np.split(scale * excess[..., :-1, :], [-1], axis=-1)
        noise_share = np.einsum("...ii", P @ D)[..., None, None]
        share = COVARIANCE.max_noise_share / np.maximum(noise_share, COVARIANCE.max_noise_share)
        # (J - D) (theta + correction) = J theta - d, with J = 1 / P
        step = share * (P @ (D @ theta[..., None] - d))
        self.correction = np.linalg.solve(np.eye(P.shape[-1]) - share * (P @ D), step)[..., 0]
        remaining = 1.0 / share - 1.0 + COVARIANCE.noise_uncertainty  # bias relative to the correction
        self._bias = remaining**2 * self.correction[..., None] * self.correction[..., None, :]
        return np.asarray(scale * share)

    def make_covariance(self, squares: Recursion) -> Callable[[], tuple[Array, Array]]:
        """Return a function that computes P and the covariance of now, also later."""
        state = squares.squares, squares.count, squares.prior
        return functools.partial(
            _compute_covariances, squares.unit_covariance(), self._scores, self._bias, self._n_clusters, *state
        )


def _compute_covariances(
    compute_P: Callable[[], Array],
    scores: Array,
    bias: Array,
    n_clusters: Index,
    squares: Array,
    count: Array,
    prior: float,
) -> tuple[Array, Array]:
    """Compute P and covariance of estimates (B, S, P, P).

    The covariance comes from the scores if there are `min_extra_clusters` more clusters than parameters, else from
    white errors.

    Args:
        compute_P: returns the covariance for unit noise.
        scores: sum of squared scores s s' over the clusters (B, S, P, P).
        bias: square of the bias that the correction may leave (B, S, P, P).
        n_clusters: number of clusters with equations (B, S).
        squares: sum of squared errors (B, S).
        count: number of equations (B, S).
        prior: P(0) on the diagonal.
    """
    P = compute_P()
    parameters = P.shape[-1]
    freedom = count - parameters
    # before the first equations, the covariance is P(0)
    noise = np.where(freedom > 0, squares / np.maximum(freedom, 1.0), 1.0 / COVARIANCE.guess_variance)
    guess = COVARIANCE.guess_variance * noise[..., None, None] * P
    correction = (n_clusters - 1) / np.maximum(n_clusters, 1)
    # the second part is the variance of theta(0)
    robust = correction[..., None, None] * (P @ scores @ P) + (noise / prior)[..., None, None] * (P @ P)
    is_robust = n_clusters >= parameters + COVARIANCE.min_extra_clusters
    return P, np.where(is_robust[..., None, None], robust, guess) + bias
