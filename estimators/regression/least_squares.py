"""Least squares within bounds, with standard errors under correlated residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.errors import UserError

RIDGE = 1e-11  # added to the diagonal of normal equations scaled to unit diagonal; keeps a solve finite


@dataclass(frozen=True)
class SolverSettings:
    """Numbers of least squares."""

    shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)  # of a Gauss-Newton step, tried in this order
    distinct: float = 1e-6  # least eigenvalue of scaled normal equations that are solved: they keep ten digits
    unlikelier: float = 0.1  # [nat], largest error of a log likelihood by the tangent
    linear_response: float = 1e-9  # largest difference from one of the slope of a linear response to torque
    tiny: float = 1e-9  # lower limit of a derivative by the torque
    iterations: int = 30  # largest number of Gauss-Newton steps
    enough: float = 1e-9  # relative decrease of the squared error at which Gauss-Newton ends
    converged: float = 0.01  # largest Gauss-Newton step of a converged fit [standard errors]


SOLVER = SolverSettings()


class IdentificationError(UserError):
    """Error of data that do not determine the result; the message has the cause and the remedy.

    Attributes:
        effect: id of the effect that the data do not show, if that is the reason.
    """

    def __init__(self, message: str, effect: str = "") -> None:
        super().__init__(message)
        self.effect = effect


@dataclass(frozen=True)
class Equations:
    """Linear regression y = phi theta + error: phi (R, P), y (R,) [N m]."""

    phi: Array
    y: Array


@dataclass(frozen=True)
class Fit:
    """Solution of a regression.

    Attributes:
        theta: parameters (P,).
        covariance: covariance of theta (P, P), from clusters of residuals.
        residual: y - phi theta (R,) [N m].
        condition: condition number of the regressor with columns scaled to equal length.
        freedom: degrees of freedom of each standard error (P,).
    """

    theta: Array
    covariance: Array
    residual: Array
    condition: float
    freedom: Array

    @property
    def std(self) -> Array:
        """Standard errors (P,); a negative variance, by rounding, counts as zero."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def rms(self) -> float:
        """Root mean square residual, the paper's norm (10) [N m]."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def compute_std_by_noise(self, floor: float) -> Array:
        """Return the standard errors (P,) by noise alone, whose root mean square is `floor` [N m]."""
        return self.std * min(1.0, floor / max(self.rms, 1e-300))


def solve(equations: Equations, weights: Array, clusters: Index) -> Fit:
    """Solve weighted least squares, with standard errors from the spread between clusters of equations.

    Args:
        equations: R equations in P unknowns.
        weights: relative weight of each equation (R,).
        clusters: stretch of time of each equation (R,), within which residuals may be correlated.
    """
    phi = equations.phi * weights[:, None]
    theta = solve_least_squares(phi, equations.y * weights)
    residual = equations.y - equations.phi @ theta
    covariance, freedom = compute_jackknife(phi, residual * weights, clusters)
    return Fit(theta, widen_covariance(covariance, freedom), residual, compute_condition(phi), freedom)


def compute_condition(phi: Array) -> float:
    """Return the condition number of columns (R, P) scaled to equal length."""
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = 1.0
    values = np.linalg.eigvalsh(phi.T @ phi / np.outer(scale, scale))
    if len(values) and values[0] > SOLVER.distinct:
        return float(np.sqrt(values[-1] / values[0]))
    singular = np.linalg.svd(np.linalg.qr(phi / scale, mode="r"), compute_uv=False)
    return float(singular[0] / max(singular[-1], 1e-300)) if len(singular) else 1.0


def is_converged(residual: Array, change: Array) -> bool:
    """Return whether a Gauss-Newton step, which changes the residual (R,) by `change` (R,), is negligible.

    The test is |change| sqrt(R) <= `SOLVER.converged` |residual|.

    Source: Bates and Watts, Technometrics 23(2), 1981 (the relative offset).
    """
    return bool(np.linalg.norm(change) * np.sqrt(len(residual)) <= SOLVER.converged * np.linalg.norm(residual))


def compute_robust_covariance(phi: Array, residual: Array, clusters: Index) -> Array:
    """Return the widened covariance (P, P) of least squares, see `compute_jackknife` and `widen_covariance`."""
    return widen_covariance(*compute_jackknife(phi, residual, clusters))


def widen_covariance(covariance: Array, freedom: Array) -> Array:
    """Widen a covariance (P, P) with degrees of freedom (P,) until 1.96 standard errors cover 95 %.

    Standard errors from few clusters scatter as Student's t.
    """
    widening = compute_widening(freedom)
    return np.asarray(covariance * np.outer(widening, widening))


def compute_widening(freedom: Array) -> Array:
    """Return the factor on standard errors with some degrees of freedom, see `widen_covariance`."""
    return np.asarray(scipy.special.stdtrit(np.maximum(freedom, 2.0), 0.975) / scipy.special.ndtri(0.975))


def compute_jackknife(phi: Array, residual: Array, clusters: Index) -> tuple[Array, Array]:
    """Return the covariance of least squares by leaving out each of C clusters, and its degrees of freedom.

    The score of a cluster with columns X and residuals e is (I - X'X B)^-1 X'e, B = (phi' phi)^-1. The inverse removes
    the influence of the cluster on its residuals.

    Args:
        phi: columns (R, P).
        residual: correlated within clusters (R,).
        clusters: cluster of each row (R,). If it is one cluster, each row counts as a cluster.

    Returns:
        The covariance (P, P), and the degrees of freedom of each variance (P,).

    Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (CR3, and degrees of freedom after Satterthwaite).
    """
    if len(clusters) and not clusters.any():
        clusters = np.arange(len(clusters))
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = 1.0
    phi = phi / scale
    inverse = np.linalg.pinv(phi.T @ phi, rcond=1e-12, hermitian=True)
    count = int(clusters.max()) + 1
    parts = [(phi[rows], residual[rows]) for rows in (clusters == cluster for cluster in range(count))]
    grams = np.array([x.T @ x for x, _ in parts])
    hats, longest = grams @ inverse, max(len(x) for x, _ in parts)
    if longest < len(inverse):  # matrices (longest, longest) are smaller: phi' (I - phi B phi')^-1 e
        columns, padded = np.zeros((count, longest, len(inverse))), np.zeros((count, longest, 1))
        for k, (x, errors) in enumerate(parts):
            columns[k, : len(x)], padded[k, : len(x), 0] = x, errors
        transposed = np.swapaxes(columns, 1, 2)
        remaining = np.eye(longest) - columns @ inverse @ transposed
        scores_without = (transposed @ (_invert_matrices(remaining) @ padded))[:, :, 0]
    else:
        scores = np.array([x.T @ errors for x, errors in parts])
        remaining = np.eye(len(inverse)) - hats
        scores_without = (_invert_matrices(remaining) @ scores[:, :, None])[:, :, 0]
    shares = np.einsum("ij,kji->ki", inverse, hats)
    score_products = scores_without.T @ scores_without
    covariance = (count - 1) / count * inverse @ score_products @ inverse
    freedom = shares.sum(axis=0) ** 2 / np.maximum((shares**2).sum(axis=0), 1e-300)
    with np.errstate(over="ignore"):  # a column of nearly zero has an infinite error
        return np.asarray(covariance / np.outer(scale, scale)), freedom


def _invert_matrices(matrices: Array) -> Array:
    """Invert matrices (C, P, P); pseudo-invert, ten times as slow, those that may be singular."""
    try:
        inverses = np.linalg.inv(matrices)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrices, rcond=1e-6))
    is_singular = ~(np.linalg.norm(inverses, axis=(1, 2)) * np.linalg.norm(matrices, axis=(1, 2)) < 1e6)
    inverses[is_singular] = np.linalg.pinv(matrices[is_singular], rcond=1e-6)
    return np.asarray(inverses)


def solve_within_bounds(
    solve: Callable[[Array, Mask], Array], theta: Array, free: Mask, least: Array, most: Array
) -> tuple[Array, Mask]:
    """Solve for parameters (P,) within bounds by an active set; return parameters and mask of the free parameters.

    Free parameters that leave their bounds are held at them. If two or more are held, a parameter that moves inside is
    freed again.

    Args:
        solve: function from parameters (P,) and mask of free parameters (P,) to the solution.
        theta: start, and values of the parameters that are not free (P,).
        free: mask of the parameters to solve for (P,).
        least, most: bounds (P,).
    """
    fixed, tried_masks = ~free, set[bytes]()
    while True:
        theta = solve(theta, free)
        bounded = np.clip(theta, least, most)
        leaves = free & (bounded != theta)
        theta, free = np.where(leaves, bounded, theta), free & ~leaves
        if leaves.any():
            continue
        held_parameters = np.flatnonzero(~free & ~fixed)
        if len(held_parameters) < 2 or free.tobytes() in tried_masks:
            return theta, free
        tried_masks.add(free.tobytes())
        for k in held_parameters:
            freed = free | (np.arange(len(free)) == k)
            if least[k] < solve(theta, freed)[k] < most[k]:
                free = freed
                break
        else:
            return theta, free


def sum_without_each(grams: Array) -> Array:
    """Return for each of K folds the sum of the Gram matrices (K, P + 1, P + 1) of the other folds."""
    others = 1.0 - np.eye(len(grams))  # a difference of total and fold loses digits
    return np.asarray(np.einsum("lk,kij->lij", others, grams))


def solve_gram(gram: Array, least: Array, most: Array) -> Array | None:
    """Solve normal equations for parameters (P,) within bounds, from the Gram matrix (P + 1, P + 1) of [y, phi].

    Return None without parameters, or for nearly collinear columns, where normal equations lose too many digits.
    """
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    gram, size = gram / np.outer(size, size), size[1:] / size[0]
    phi, y = gram[1:, 1:], gram[1:, 0]
    if not len(size) or _factorise(phi) is None:
        return None
    return solve_within(phi, y, least * size, most * size) / size


def solve_within(normal: Array, target: Array, least: Array, most: Array) -> Array:
    """Solve normal equations (P, P) with the right-hand side `target` (P,) for parameters (P,) within bounds (P,)."""

    def solve(theta: Array, free: Mask) -> Array:
        theta = np.where(free, 0.0, theta)
        theta[free] = np.linalg.solve(normal[np.ix_(free, free)], (target - normal @ theta)[free])
        return theta

    return solve_within_bounds(solve, np.zeros(len(target)), np.ones(len(target), dtype=bool), least, most)[0]


def weigh_joints(equations: Equations, joint: Index) -> Array:
    """Compute weights (R,) of the rows by the noise of their joints."""
    phi, y = equations.phi, equations.y
    w = 1.0 / compute_joint_rms(y, joint)[joint]
    theta = solve_least_squares(phi * w[:, None], y * w)
    return np.asarray(1.0 / compute_joint_rms(y - phi @ theta, joint)[joint])


def compute_joint_rms(values: Array, joint: Index) -> Array:
    """Compute the root mean square of each joint (n,)."""
    return np.sqrt(np.maximum(np.bincount(joint, values**2) / np.maximum(np.bincount(joint), 1), 1e-24))


def subtract_known_columns(equations: Equations, columns: Sequence[int], theta: Array) -> Equations:
    """Move columns with known parameters theta (G,) from phi (R, P) to y."""
    known = list(columns)
    return Equations(np.delete(equations.phi, known, axis=1), equations.y - equations.phi[:, known] @ theta)


def weigh_recordings(squares: Array, counts: Index, least: float) -> Array:
    """Return the weight of each recording (E,): the lowest RMS residual of all over its own, at most one.

    `squares` (E,) are sums of squared residuals over `counts` (E,) equations. An RMS below `least` counts as `least`.
    A recording without equations has weight zero.
    """
    levels = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), least) + 1e-300
    return np.where(counts > 0, levels[counts > 0].min() / levels, 0.0)


def invert_covariance(covariance: Array) -> Array:
    """Return the pseudo-inverse of a covariance (P, P), zero for parameters and directions without variance."""
    size = np.sqrt(np.diag(covariance))
    size[size == 0] = np.inf
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(covariance / scale, rcond=1e-10, hermitian=True) / scale)


def project_out(frame: Array, columns: Array) -> Array:
    """Return the part of columns (R, ...) outside the span of an orthonormal frame (R, P)."""
    return np.asarray(columns - frame @ (frame.T @ columns))


def solve_least_squares(phi: Array, y: Array) -> Array:
    """Solve least squares with columns (R, P) and left-hand side (R,) for parameters (P,); zero for a column of zeros.

    Nearly collinear columns are solved by singular value decomposition, others by normal equations.
    """
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = np.inf
    phi = phi / scale
    factor = _factorise(phi.T @ phi) if phi.shape[1] else None
    if factor is not None:
        return np.asarray(scipy.linalg.lapack.dpotrs(factor, phi.T @ y)[0] / scale)
    return np.asarray(np.linalg.lstsq(phi, y, rcond=1e-10)[0] / scale)


def reduce_to_triangle(phi: Array, y: Array) -> Array:
    """Return at most P + 1 equations [phi, y] with the same squared error as R with columns (R, P) and y (R,)."""
    scale = np.linalg.norm(phi, axis=0)
    used = np.flatnonzero(scale)
    scaled = phi[:, used] / scale[used]
    factor = _factorise(scaled.T @ scaled) if len(used) else None
    if factor is None:
        return np.asarray(np.linalg.qr(np.column_stack([phi, y]), mode="r"))
    triangle, factor_triangle = np.zeros((len(used) + 1, len(scale) + 1)), np.triu(factor)
    projection = scipy.linalg.lapack.dtrtrs(factor_triangle, scaled.T @ y, trans=1)[0]
    triangle[:-1, used], triangle[:-1, -1] = factor_triangle * scale[used], projection
    triangle[-1, -1] = np.linalg.norm(y - scaled @ scipy.linalg.lapack.dtrtrs(factor_triangle, projection)[0])
    return triangle


def _factorise(gram: Array) -> Array | None:
    """Compute the upper Cholesky factor of scaled normal equations G (P, P); None if their least eigenvalue is small.

    The eigenvalue is at least LAPACK's estimate of 1 / |G^-1|_1.
    """
    factor, fault = scipy.linalg.lapack.dpotrf(gram)
    size = float(np.abs(gram).sum(axis=0).max())
    return None if fault or size * scipy.linalg.lapack.dpocon(factor, size)[0] <= SOLVER.distinct else factor
