"""Least squares with block cross-validation and standard errors that hold under correlated residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from estimators.equations import Equations
from pendulum_env._typing import Array, Index

RIDGE = 1e-11  # relative; keeps a solve with two equal columns finite


@dataclass(frozen=True)
class Fit:
    """Solution of a regression.

    Attributes:
        theta: parameters (P,).
        covariance: of theta (P, P), from clusters of residuals.
        residual: y - phi theta (R,) [N m].
        worst_direction: unit vector (P,) in scaled parameters that the data say least about.
        condition: condition number of the regressor with columns scaled to equal length.
    """

    theta: Array
    covariance: Array
    residual: Array
    worst_direction: Array
    condition: float

    @property
    def std(self) -> Array:
        """Standard errors (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rms(self) -> float:
        """Root mean square residual, the paper's norm (10) [N m]."""
        return float(np.sqrt(np.mean(self.residual**2)))


def solve(equations: Equations, weights: Array, clusters: Index, jacobian: Array | None = None) -> Fit:
    """Weighted least squares; standard errors from the spread between clusters of equations.

    Args:
        equations: R equations in P unknowns.
        weights: relative weight of each equation (R,).
        clusters: stretch of time of each equation (R,); residuals may be correlated within one.
        jacobian: further columns (R, S), derivatives with respect to shape parameters that were searched for: they
            widen the standard errors (and appear after theta in the covariance), but are not solved for.
    """
    phi, y = equations.phi * weights[:, None], equations.y * weights
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = 1.0
    q, triangle = np.linalg.qr(phi / scale)
    left, singular, directions = np.linalg.svd(triangle)
    inverse = np.where(singular > 1e-10 * singular.max(initial=0.0), 1.0 / np.maximum(singular, 1e-300), 0.0)
    theta = directions.T @ (inverse * (left.T @ (q.T @ y))) / scale
    residual = equations.y - equations.phi @ theta
    full = phi if jacobian is None else np.column_stack([phi, jacobian * weights[:, None]])
    covariance = robust_covariance(full, residual * weights, clusters)
    condition = float(singular[0] / max(singular[-1], 1e-300)) if len(singular) else 1.0
    return Fit(theta, covariance, residual, directions[-1], condition)


def robust_covariance(phi: Array, residual: Array, clusters: Index) -> Array:
    """Covariance (P, P) of least squares whose R residuals may be correlated within clusters.

    It is the jackknife's. What only few clusters tell of a parameter scatters as Student's t does: then it is widened,
    until 1.96 standard errors cover 95 % all the same.

    Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (CR3, and degrees of freedom after Satterthwaite).
    """
    covariance, told = jackknife(phi, residual, clusters)
    freedom = told.sum(axis=0) ** 2 / np.maximum((told**2).sum(axis=0), 1e-300)
    wider = student.ppf(0.975, np.maximum(freedom, 2.0)) / norm.ppf(0.975)
    return np.asarray(covariance * np.outer(wider, wider))


def jackknife(phi: Array, residual: Array, clusters: Index) -> tuple[Array, Array]:
    """Covariance (P, P) from leaving out each of C clusters, and what each tells of every parameter (C, P).

    A fit follows the clusters that tell it most, whose residuals then look too small. Each cluster's score is what it
    is without its own pull, (I - X'X B)^-1 X'e with B = (phi' phi)^-1, so that few clusters do not feign certainty.
    """
    size = np.linalg.norm(phi, axis=0)
    size[size == 0] = 1.0
    phi = phi / size
    bread = np.linalg.pinv(phi.T @ phi, rcond=1e-12, hermitian=True)
    count = int(clusters.max()) + 1
    scores, meat = np.zeros((count, phi.shape[1])), np.zeros_like(bread)
    told = np.zeros_like(scores)
    np.add.at(scores, clusters, phi * residual[:, None])
    for cluster, score in enumerate(scores):
        own = phi[clusters == cluster]
        alone = np.linalg.pinv(np.eye(len(bread)) - own.T @ own @ bread, rcond=1e-6) @ score
        meat += np.outer(alone, alone)
        told[cluster] = np.sum((own @ bread) ** 2, axis=0)
    covariance = (count - 1) / count * bread @ meat @ bread
    return np.asarray(covariance / np.outer(size, size)), told


def block_grams(columns: Array, blocks: Index) -> Array:
    """Gram matrices of each block, (B, V, C, C), from columns (V, R, C) of V alternatives."""
    count = int(blocks.max()) + 1
    return np.stack(
        [np.swapaxes(columns[:, rows], 1, 2) @ columns[:, rows] for rows in (blocks == b for b in range(count))]
    )


def cross_validate(grams: Array) -> tuple[Array, Array, Array]:
    """Residual sums of squares, fitted and cross-validated, of V alternatives whose last column is y.

    Args:
        grams: Gram matrices of each block, (B, V, C, C).

    Returns:
        Sum of squared residuals of the fit to all blocks (V,), of predictions of each block from the others (V,), and
        the parameters of the fit (V, C - 1).
    """
    total = grams.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diagonal(total, axis1=1, axis2=2), 1e-300))  # (V, C)
    grams = grams / (scale[:, :, None] * scale[:, None, :])
    total = grams.sum(axis=0)
    parameters = total.shape[-1] - 1
    ridge = RIDGE * np.eye(parameters)

    def solution(training: Array) -> Array:
        return np.asarray(np.linalg.solve(training[..., :-1, :-1] + ridge, training[..., :-1, -1:]))

    def errors(theta: Array, testing: Array) -> Array:
        cross = np.swapaxes(testing[..., :-1, -1:], -1, -2) @ theta
        square = np.swapaxes(theta, -1, -2) @ testing[..., :-1, :-1] @ theta
        return testing[..., -1, -1] - 2 * cross[..., 0, 0] + square[..., 0, 0]

    theta = solution(total)
    fitted = errors(theta, total) * scale[:, -1] ** 2
    predicted = errors(solution(total - grams), grams).sum(axis=0) * scale[:, -1] ** 2
    return (
        np.maximum(fitted, 0.0),
        np.maximum(predicted, 0.0),
        np.asarray(theta[:, :, 0] * scale[:, -1:] / scale[:, :-1]),
    )
