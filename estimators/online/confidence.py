"""Online covariances of estimates under correlated errors, from sums over short clusters of time.

theta - truth = P sum_k phi_k e_k. A cluster with the sums A = sum phi phi' and b = sum phi y has the score
s = b - A theta. The covariance is P (sum of s s') P, valid for correlated and filtered errors. Since theta is
fitted to the cluster, s is too small. It is replaced by the score J / (J - A) s of a fit without the cluster, with
J = 1 / P. Neighbouring clusters are merged to limit their number to a few dozen. With forgetting, clusters stay much
shorter than the memory, and the oldest are dropped. Directions without data keep the variance of P(0).

Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (jackknife).
"""

import functools
from collections.abc import Callable

import numpy as np

from estimators.online.recursion import RecursionState, expand_triangle
from estimators.online.settings import ONLINE
from estimators.schemes.identifiability import ONE_SIZE_RESIDUAL
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics.compiled import Machine, SymbolicStep
from pendulum_env.physics.symbols import make_symbols


class ClusterCovariance:
    """Sums over clusters for (B, S) regressions with P parameters each."""

    def __init__(
        self, batch: tuple[int, int], parameters: int, period: float, forgetting: float, direction: int | None = None
    ) -> None:
        """Create the sums for a period between equations [s] and the forgetting factor of the recursion.

        `direction` is the index of the parameter whose torque is the sign of the velocity; None without such a test.
        """
        self._forgetting, self._direction = forgetting, direction
        self._max_length = ONLINE.covariance.memory_share / (1.0 - forgetting) if forgetting < 1 else np.inf
        self._min_length = max(2, round(min(ONLINE.bins.chunk_time / period, self._max_length)))
        self._clusters = np.zeros((ONLINE.covariance.most, *batch, parameters, parameters + 1))  # A and b
        self._machine = Machine(_add_products, (parameters + 1,), *batch[::-1])
        self._scores = np.zeros((*batch, parameters, parameters))
        self._n_clusters = np.zeros(batch, dtype=int)  # clusters with equations
        self._length, self._n_rows, self._n_closed = self._min_length, 0, 0

    def reset(self, which: Mask) -> None:
        """Restart plants (B,); the others keep their clusters."""
        self._clusters[:, which] = 0.0
        self._machine.reset(which)
        # covariance functions in use keep the old arrays
        self._scores, self._n_clusters = self._scores.copy(), self._n_clusters.copy()
        self._scores[which] = self._n_clusters[which] = 0
        if which.all():
            self._length, self._n_rows, self._n_closed = self._min_length, 0, 0

    def take(self, equations: Array, usable: Mask) -> bool:
        """Add one equation of each regression, phi and y (B, S, P + 1), where usable (B, S).

        Returns:
            True if the current cluster is long enough to be closed.
        """
        inputs = self._machine.inputs
        inputs["row"].T[:], inputs["used"].T[:] = equations, usable
        self._machine.step()
        self._n_rows += 1
        return self._n_rows >= self._length

    def close_cluster(self, state: RecursionState) -> None:
        """Close the current cluster, and compute the scores of all clusters at the current estimates.

        A cluster without equations is dropped; others lower the weight of the earlier clusters by forgetting. At
        the largest number, neighbours are merged, or the oldest is dropped.
        """
        self._n_rows, now = 0, self._machine.states
        n_used = now["count"].T.copy()
        if not n_used.any():
            return
        theta, P = state.theta, state.P
        if self._forgetting < 1:
            self._clusters[: self._n_closed] *= (self._forgetting**n_used)[..., None, None]
        self._clusters[self._n_closed] = expand_triangle(now["products"].T)[..., :-1, :]
        self._n_closed += 1
        has_equations = n_used > 0
        self._machine.reset(np.ones(1, dtype=bool))
        if self._n_closed == ONLINE.covariance.most and 2 * self._length <= self._max_length:
            half = ONLINE.covariance.most // 2
            self._clusters[:half] = self._clusters[0::2] + self._clusters[1::2]
            self._clusters[half:] = 0.0
            self._n_closed, self._length = half, 2 * self._length
        elif self._n_closed == ONLINE.covariance.most:
            self._clusters[:-1, has_equations] = self._clusters[1:, has_equations]  # no forgetting at rest
            self._n_closed -= 1
        A, b = np.split(self._clusters[: self._n_closed], [-1], axis=-1)
        score = b - A @ theta[..., None]  # (clusters, B, S, P, 1)
        # J / (J - A) = 1 / (1 - A P); 1e-9 is for a cluster with all the information
        score = np.asarray(np.linalg.solve((1.0 + 1e-9) * np.eye(P.shape[-1]) - A @ P, score), dtype=float)
        self._scores = (score @ score.swapaxes(-1, -2)).sum(axis=0)
        self._n_clusters = np.count_nonzero(np.einsum("c...ii->c...", A), axis=0)

    def make_covariance(self, state: RecursionState) -> Callable[[], Array]:
        """Make a function that computes the covariance of estimates (B, S, P, P) at any time."""
        return functools.partial(_compute_covariance, state, self._scores, self._n_clusters, self._direction)


@functools.cache
def _add_products(size: int) -> SymbolicStep:
    """Build the sums over a cluster, in symbols: the upper triangle of products of phi and y, and their number."""
    inputs = {"row": make_symbols("row", size), "used": make_symbols("used")}
    rows, columns = np.triu_indices(size)
    row, before = inputs["row"] * inputs["used"], {"products": make_symbols("products", len(rows))}
    before["count"] = make_symbols("count")
    after = {"products": before["products"] + row[rows] * row[columns], "count": before["count"] + inputs["used"]}
    return SymbolicStep(inputs, before, after)


def _compute_covariance(state: RecursionState, scores: Array, n_clusters: Index, direction: int | None) -> Array:
    """Compute the covariance of estimates (B, S, P, P).

    It comes from the scores if clusters outnumber parameters by far, else from white errors. It is infinite if the
    torque depends on the direction of motion alone.

    Args:
        state: state of the recursion.
        scores: sum of squared scores s s' over the clusters (B, S, P, P).
        n_clusters: number of clusters with equations (B, S).
        direction: index of the parameter whose torque is the sign of the velocity; None without a test.
    """
    P, parameters = state.P, state.P.shape[-1]
    freedom = state.count - parameters
    # before the first equations, the covariance is P(0)
    noise = np.where(freedom > 0, state.squares / np.maximum(freedom, 1.0), 1.0 / ONLINE.covariance.guess)
    guess = ONLINE.covariance.guess * noise[..., None, None] * P
    correction = (n_clusters - 1) / np.maximum(n_clusters, 1)
    # the second part is the variance of theta(0)
    robust = correction[..., None, None] * (P @ scores @ P) + (noise / state.prior)[..., None, None] * (P @ P)
    is_robust = n_clusters >= parameters + ONLINE.covariance.extra
    covariance = np.where(is_robust[..., None, None], robust, guess)
    if direction is not None:
        follows = _follows_direction(state, direction)
        covariance = np.where(follows[..., None, None], np.diag(np.full(parameters, np.inf)), covariance)
    return covariance


def _follows_direction(state: RecursionState, direction: int) -> Mask:
    """Return whether the torque depends on the direction of motion alone (B, S).

    Then zeros and a dry friction of the size of the torque solve all equations, too. With J = 1 / P, the equations have
    y'y = squares + theta' J theta. The best multiple of column k alone explains (J theta)_k^2 / J_kk of it.
    """
    J = np.asarray(np.linalg.inv(state.P), dtype=float)
    moments = np.einsum("...ij,...j", J, state.theta)
    total = state.squares + np.einsum("...i,...i", state.theta, moments)
    explained = moments[..., direction] ** 2 / J[..., direction, direction]
    return np.asarray((total > 0) & (total - explained <= ONE_SIZE_RESIDUAL**2 * total))
