"""Least squares with block cross-validation and standard errors that hold under correlated residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from pendulum_env._typing import Array, Index, Mask
from pendulum_env.errors import UserError

RIDGE = 1e-11  # relative; keeps a solve with two equal columns finite


@dataclass(frozen=True)
class SolverSettings:
    """Numbers of least squares."""

    shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)  # of its step that are tried
    distinct: float = 1e-6  # least eigenvalue of scaled normal equations, from which they keep ten digits
    unlikelier: float = 0.1  # [nat], by which a fit without a fold may be less likely than the best
    linear_response: float = 1e-9  # by which a response to torque may differ from the torque itself
    tiny: float = 1e-9  # slope of an equation by the torque that says nothing of it
    turns: int = 30  # of Gauss-Newton, at most
    enough: float = 1e-9  # relative fall of the squared error, at which Gauss-Newton ends
    converged: float = 0.01  # standard errors that a Gauss-Newton step may still take


SOLVER = SolverSettings()


class IdentificationError(UserError):
    """Data from which nothing can be identified; the message says why and what to record instead.

    Attributes:
        effect: id of the effect that the data do not show, if that is the reason.
    """

    def __init__(self, message: str, effect: str = "") -> None:
        super().__init__(message)
        self.effect = effect


@dataclass(frozen=True)
class Equations:
    """Linear regression y = phi theta + error in N m: phi (R, P), y (R,)."""

    phi: Array
    y: Array


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
        """Standard errors (P,); a variance that rounding makes negative counts as zero."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def rms(self) -> float:
        """Root mean square residual, the paper's norm (10) [N m]."""
        return float(np.sqrt(np.mean(self.residual**2)))


def solve(equations: Equations, weights: Array, clusters: Index, jacobian: Array | None = None) -> Fit:
    """Solve weighted least squares, with standard errors from the spread between clusters of equations.

    Args:
        equations: R equations in P unknowns.
        weights: relative weight of each equation (R,).
        clusters: stretch of time of each equation (R,); residuals may be correlated within one.
        jacobian: further columns (R, S), derivatives with respect to nonlinear parameters that were searched for: they
            widen the standard errors (and appear after theta in the covariance), but are not solved for.
    """
    phi = equations.phi * weights[:, None]
    theta = solve_least_squares(phi, equations.y * weights)
    residual = equations.y - equations.phi @ theta
    condition, direction = find_worst_direction(phi)
    full = phi if jacobian is None else np.column_stack([phi, jacobian * weights[:, None]])
    covariance = compute_robust_covariance(full, residual * weights, clusters)
    return Fit(theta, covariance, residual, direction, condition)


def find_worst_direction(phi: Array) -> tuple[float, Array]:
    """Return condition number and least determined direction (P,) of columns (R, P) scaled to equal length."""
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh((gram := phi.T @ phi) / np.outer(scale, scale))
    if len(gram) and values[0] > SOLVER.distinct:
        return float(np.sqrt(values[-1] / values[0])), vectors[:, 0]
    singular, directions = np.linalg.svd(np.linalg.qr(phi / scale, mode="r"))[1:]
    return float(singular[0] / max(singular[-1], 1e-300)) if len(singular) else 1.0, directions[-1]


def is_converged(residual: Array, change: Array) -> bool:
    """Return whether a Gauss-Newton step, with its `change` (R,) of the residual (R,), is below standard errors.

    `change` is then small beside the residual in any one direction, and the fit depends neither on its start nor on the
    order of sums.

    Source: Bates and Watts, Technometrics 23(2), 1981 (the relative offset).
    """
    return bool(np.linalg.norm(change) * np.sqrt(len(residual)) <= SOLVER.converged * np.linalg.norm(residual))


def compute_robust_covariance(phi: Array, residual: Array, clusters: Index) -> Array:
    """Return the covariance (P, P) of least squares with residuals (R,) that may be correlated within clusters.

    It is the jackknife's. A parameter that few clusters determine scatters as Student's t: its variance is widened
    until 1.96 standard errors cover 95 %.

    Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (CR3, and degrees of freedom after Satterthwaite).
    """
    if len(clusters) and not clusters.any():  # one cluster has no others to be compared with: its residuals have
        clusters = np.arange(len(clusters))
    covariance, told = compute_jackknife(phi, residual, clusters)
    freedom = told.sum(axis=0) ** 2 / np.maximum((told**2).sum(axis=0), 1e-300)
    wider = scipy.special.stdtrit(np.maximum(freedom, 2.0), 0.975) / scipy.special.ndtri(0.975)
    return np.asarray(covariance * np.outer(wider, wider))


def compute_jackknife(phi: Array, residual: Array, clusters: Index) -> tuple[Array, Array]:
    """Return the covariance (P, P) by leaving out each of C clusters, and the share of each in every parameter (C, P).

    A fit follows the clusters that tell it most, whose residuals then look too small. Each cluster's score is what it
    is without its own pull, (I - X'X B)^-1 X'e with B = (phi' phi)^-1, so that few clusters do not feign certainty.
    """
    size = np.linalg.norm(phi, axis=0)
    size[size == 0] = 1.0
    phi = phi / size
    bread = np.linalg.pinv(phi.T @ phi, rcond=1e-12, hermitian=True)
    count = int(clusters.max()) + 1
    parts = [(phi[rows], residual[rows]) for rows in (clusters == cluster for cluster in range(count))]
    grams = np.array([own.T @ own for own, _ in parts])
    if max(len(own) for own, _ in parts) < len(bread):  # the same by matrices as small as the clusters are
        alone = np.array([_compute_cluster_score(own, left, np.asarray(bread)) for own, left in parts])
    else:
        scores = np.array([own.T @ left for own, left in parts])
        kept = np.eye(len(bread)) - grams @ bread
        alone = (_invert_matrices(kept) @ scores[:, :, None])[:, :, 0]
    told = np.einsum("ij,kji->ki", bread, grams @ bread)
    meat = alone.T @ alone
    covariance = (count - 1) / count * bread @ meat @ bread
    return np.asarray(covariance / np.outer(size, size)), told


def _invert_matrices(matrices: Array) -> Array:
    """Invert matrices (C, P, P); pseudo-inverses where one may be singular, which take ten times as long."""
    try:
        found = np.linalg.inv(matrices)
        if np.all(np.linalg.norm(found, axis=(1, 2)) * np.linalg.norm(matrices, axis=(1, 2)) < 1e6):
            return np.asarray(found)
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.pinv(matrices, rcond=1e-6))


def _compute_cluster_score(phi: Array, residual: Array, bread: Array) -> Array:
    """Compute the score (P,) of a cluster's rows (R, P) without its own influence, phi' (I - phi B phi')^-1 e."""
    kept = np.eye(len(phi)) - phi @ bread @ phi.T
    return np.asarray(phi.T @ (np.linalg.pinv(kept, rcond=1e-6, hermitian=True) @ residual))


def solve_within_bounds(
    solve: Callable[[Array, Mask], Array], theta: Array, free: Mask, least: Array, most: Array
) -> tuple[Array, Mask]:
    """Solve for parameters (P,) within bounds; return them with the mask of those that are not at a bound.

    The solver gives the parameters with the free ones (P,) found anew. Those that leave are held at their bounds; of
    several that are held, one is let go where it would move back inside (an active set).
    """
    known, tried = ~free, set[bytes]()
    while True:
        theta = solve(theta, free)
        bounded = np.clip(theta, least, most)
        leaves = free & (bounded != theta)
        theta, free = np.where(leaves, bounded, theta), free & ~leaves
        if leaves.any():
            continue
        held = np.flatnonzero(~free & ~known)
        if len(held) < 2 or free.tobytes() in tried:
            return theta, free
        tried.add(free.tobytes())
        for k in held:
            freed = free | (np.arange(len(free)) == k)
            if least[k] < solve(theta, freed)[k] < most[k]:
                free = freed
                break
        else:
            return theta, free


def sum_without_each(grams: Array) -> Array:
    """Return the Gram matrices without each of K folds, given those of the folds (K, P + 1, P + 1)."""
    others = 1.0 - np.eye(len(grams))  # not the difference from the whole, which loses digits
    return np.asarray(np.einsum("lk,kij->lij", others, grams))


def solve_gram(gram: Array, least: Array, most: Array) -> Array | None:
    """Solve normal equations within bounds for parameters (P,), given the Gram matrix (P + 1, P + 1) of [y, phi].

    None for nearly collinear columns, for which normal equations lose too many digits.
    """
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    gram, size = gram / np.outer(size, size), size[1:] / size[0]
    phi, y = gram[1:, 1:], gram[1:, 0]
    if not len(size) or _factor(phi) is None:
        return None
    return solve_within(phi, y, least * size, most * size) / size


def solve_within(normal: Array, target: Array, least: Array, most: Array) -> Array:
    """Solve normal equations (P, P) of a left-hand side (P,) for parameters within bounds (P,)."""

    def solve(theta: Array, free: Mask) -> Array:
        theta = np.where(free, 0.0, theta)
        theta[free] = np.linalg.solve(normal[np.ix_(free, free)], (target - normal @ theta)[free])
        return theta

    return solve_within_bounds(solve, np.zeros(len(target)), np.ones(len(target), dtype=bool), least, most)[0]


def weigh_recordings(squares: Array, counts: Index, least: float) -> Array:
    """Return the weight of each recording (E,) by the sum of its squared residuals (E,).

    A recording without equations, by `counts` (E,), has no weight; residuals below `least` count alike.
    """
    levels = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), least) + 1e-300
    return np.where(counts > 0, levels[counts > 0].min() / levels, 0.0)


def invert_covariance(covariance: Array) -> Array:
    """Return the pseudo-inverse of a covariance (P, P), zero for parameters and directions without variance.

    A regression that cannot tell two parameters apart says nothing of their difference.
    """
    size = np.sqrt(np.diag(covariance))
    size[size == 0] = np.inf
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(covariance / scale, rcond=1e-10, hermitian=True) / scale)


def project_out(frame: Array, columns: Array) -> Array:
    """Return the part of columns (R, ...) outside the span of an orthonormal frame (R, P)."""
    return np.asarray(columns - frame @ (frame.T @ columns))


def solve_least_squares(phi: Array, y: Array) -> Array:
    """Solve least squares for parameters (P,), with columns scaled to equal length; zero for a column of zeros.

    Normal equations lose twice as many digits as the columns are alike by, and are used where that is few.
    """
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = np.inf
    phi = phi / scale
    factor = _factor(phi.T @ phi) if phi.shape[1] else None
    if factor is not None:
        return np.asarray(scipy.linalg.lapack.dpotrs(factor, phi.T @ y)[0] / scale)
    return np.asarray(np.linalg.lstsq(phi, y, rcond=1e-10)[0] / scale)


def triangle_of(phi: Array, y: Array) -> Array:
    """Return few equations (<= P + 1, P + 1), equivalent to many with columns (R, P) and a left-hand side (R,)."""
    scale = np.linalg.norm(phi, axis=0)
    used = np.flatnonzero(scale)
    scaled = phi[:, used] / scale[used]
    factor = _factor(scaled.T @ scaled) if len(used) else None
    if factor is None:
        return np.asarray(np.linalg.qr(np.column_stack([phi, y]), mode="r"))
    triangle, own = np.zeros((len(used) + 1, len(scale) + 1)), np.triu(factor)
    known = scipy.linalg.lapack.dtrtrs(own, scaled.T @ y, trans=1)[0]
    triangle[:-1, used], triangle[:-1, -1] = own * scale[used], known
    triangle[-1, -1] = np.linalg.norm(y - scaled @ scipy.linalg.lapack.dtrtrs(own, known)[0])
    return triangle


def _factor(gram: Array) -> Array | None:
    """Compute the Cholesky factor of scaled normal equations (P, P); None if their least eigenvalue may be too small.

    It is at least the inverse of the largest absolute column sum of their inverse, which LAPACK estimates.
    """
    factor, fault = scipy.linalg.lapack.dpotrf(gram)
    size = float(np.abs(gram).sum(axis=0).max())
    return None if fault or size * scipy.linalg.lapack.dpocon(factor, size)[0] <= SOLVER.distinct else factor
