"""Least squares with block cross-validation and standard errors that hold under correlated residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs
from scipy.special import ndtri, stdtrit

from estimators.regression.equations import Equations
from pendulum_env._typing import Array, Index, Mask

RIDGE = 1e-11  # relative; keeps a solve with two equal columns finite
LEAST_SLOPE = 0.05  # of an equation by the torque, so that an error stays finite


@dataclass(frozen=True)
class SolverSettings:
    """Numbers of least squares."""

    shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)  # of its step that are tried
    distinct: float = 1e-6  # least eigenvalue of scaled normal equations, from which they keep ten digits
    unlikelier: float = 0.1  # [nat], by which a fit without a fold may be less likely than the best
    unbent: float = 1e-9  # by which a response to torque may differ from the torque itself
    tiny: float = 1e-9  # slope of an equation by the torque that says nothing of it
    turns: int = 30  # of Gauss-Newton, at most
    enough: float = 1e-9  # relative fall of the squared error, at which Gauss-Newton ends
    converged: float = 0.01  # standard errors that a Gauss-Newton step may still take


SOLVER = SolverSettings()


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
    phi = equations.phi * weights[:, None]
    theta = least_squares(phi, equations.y * weights)
    residual = equations.y - equations.phi @ theta
    condition, direction = worst_direction(phi)
    full = phi if jacobian is None else np.column_stack([phi, jacobian * weights[:, None]])
    covariance = robust_covariance(full, residual * weights, clusters)
    return Fit(theta, covariance, residual, direction, condition)


def worst_direction(phi: Array) -> tuple[float, Array]:
    """Condition number of columns (R, P) scaled to equal length, and the unit vector (P,) that says least in them."""
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh((gram := phi.T @ phi) / np.outer(scale, scale))
    if len(gram) and values[0] > SOLVER.distinct:
        return float(np.sqrt(values[-1] / values[0])), vectors[:, 0]
    singular, directions = np.linalg.svd(np.linalg.qr(phi / scale, mode="r"))[1:]
    return float(singular[0] / max(singular[-1], 1e-300)) if len(singular) else 1.0, directions[-1]


def is_converged(residual: Array, change: Array) -> bool:
    """Whether a Gauss-Newton step, which changes the residual (R,) by `change` (R,), is short against standard errors.

    It is if `change` is small beside what the residual has in any one direction. What is fitted then no longer depends
    on where the search began, nor on the order in which a computer adds.

    Source: Bates and Watts, Technometrics 23(2), 1981 (the relative offset).
    """
    return bool(np.linalg.norm(change) * np.sqrt(len(residual)) <= SOLVER.converged * np.linalg.norm(residual))


def robust_covariance(phi: Array, residual: Array, clusters: Index) -> Array:
    """Covariance (P, P) of least squares whose R residuals may be correlated within clusters.

    It is the jackknife's. What only few clusters tell of a parameter scatters as Student's t does: then it is widened,
    until 1.96 standard errors cover 95 % all the same.

    Source: Bell and McCaffrey, Survey Methodology 28(2), 2002 (CR3, and degrees of freedom after Satterthwaite).
    """
    if len(clusters) and not clusters.any():  # one cluster has no others to be compared with: its residuals have
        clusters = np.arange(len(clusters))
    covariance, told = jackknife(phi, residual, clusters)
    freedom = told.sum(axis=0) ** 2 / np.maximum((told**2).sum(axis=0), 1e-300)
    wider = stdtrit(np.maximum(freedom, 2.0), 0.975) / ndtri(0.975)
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
    parts = [(phi[rows], residual[rows]) for rows in (clusters == cluster for cluster in range(count))]
    grams = np.array([own.T @ own for own, _ in parts])
    if max(len(own) for own, _ in parts) < len(bread):  # the same by matrices as small as the clusters are
        alone = np.array([_alone(own, left, np.asarray(bread)) for own, left in parts])
    else:
        scores = np.array([own.T @ left for own, left in parts])
        kept = np.eye(len(bread)) - grams @ bread
        alone = (np.linalg.pinv(kept, rcond=1e-6) @ scores[:, :, None])[:, :, 0]
    told = np.einsum("ij,kji->ki", bread, grams @ bread)
    meat = alone.T @ alone
    covariance = (count - 1) / count * bread @ meat @ bread
    return np.asarray(covariance / np.outer(size, size)), told


def _alone(phi: Array, residual: Array, bread: Array) -> Array:
    """Score (P,) of a cluster's rows (R, P) without its own pull, phi' (I - phi B phi')^-1 e."""
    kept = np.eye(len(phi)) - phi @ bread @ phi.T
    return np.asarray(phi.T @ (np.linalg.pinv(kept, rcond=1e-6, hermitian=True) @ residual))


class Columns(NamedTuple):
    """Windowed columns of a term on the R rows of its joint, and their slopes by the torque.

    Attributes:
        linear: (R, P).
        fixed: sum of the columns without a parameter (R,) [N m].
        slope: of the linear ones (R, P) [1/(N m)], zero but for effects that depend on the torque.
        taken: what more the fixed ones are under each push of the torque (R, J), where they depend on it at once.
        passed: share of the torque that they leave, if they depend on what it was before.
    """

    linear: Array
    fixed: Array
    slope: Array
    taken: Array | None = None
    passed: float = 1.0


@dataclass(frozen=True)
class Balance:
    """Equations y = phi theta in which the torque that they explain may stand on both sides, as where friction grows
    with the load.

    Least squares would then explain torque by torque rather than by motion. What counts is the error of the torque that
    a model predicts from the motion: of the push of the recorded torque under which an equation would hold,

        y + response(push) = (phi + push by_torque) theta,

    exactly, however bent the response is. Where hardly any push makes up for what is missing, as beyond a saturation,
    the model is hardly possible, and the error is as large.

    Attributes:
        phi: regressor (R, P).
        y: left-hand side (R,) [N m].
        by_torque: slopes of the regressor by the torque (R, P) [1/(N m)].
        response: by which the left-hand side grows when the torque does, (R, J); the torque itself if not given.
        pushes: of the torque in each equation (R, J) [N m], growing, zero in their middle.
        least, most: bounds of the parameters (P,); one that would leave them stays at the bound.
        weights: of the equations in a fit (R,).
        passed: share of the torque that laws with memory leave, or that in each equation (R,); what takes torque away
            explains none of it.
        recorded: the same equations solved for what was recorded, where torque acts through a filter: one that only
            takes torque away explains nothing of it.
    """

    phi: Array
    y: Array
    by_torque: Array
    least: Array
    most: Array
    weights: Array
    response: Array | None = None
    pushes: Array | None = None
    passed: float | Array = 1.0
    recorded: Balance | None = None

    def __getitem__(self, rows: Mask) -> Balance:
        names = "phi", "y", "by_torque", "weights", "response", "pushes", "passed", "recorded"
        parts = ((name, getattr(self, name)) for name in names)
        chosen: dict[str, Any] = {name: part[rows] for name, part in parts if isinstance(part, np.ndarray | Balance)}
        return replace(self, **chosen)

    def error(self, theta: Array) -> Array:
        """Measured minus predicted torque (R,) [N m] at parameters (P,)."""
        return self._error(theta)[0]

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """What equations leave at each of K parameters (K, P), and how much of it each N m of torque is, (K, R) each.

        Their ratio is the error of the predicted torque, while that is small.
        """
        slope = 1.0 - theta @ self.by_torque.T if self.of_torque.any() else np.ones((len(theta), len(self.y)))
        if self.response is not None:
            bends = self._bends[1]
            middle = bends.shape[1] // 2
            slope = slope - 1.0 + 0.5 * (bends[:, middle - 1] + bends[:, middle])
        return self.y - theta @ self.phi.T, np.maximum(slope * self.passed, SOLVER.tiny)

    @property
    def reach(self) -> Array:
        """Largest error of the predicted torque that is told from a larger one, of each equation (R,) [N m]."""
        return np.full(len(self.y), np.inf) if self.pushes is None else 0.5 * self.pushes[:, -1]

    @property
    def of_torque(self) -> Mask:
        """Which parameters' columns depend on the torque (P,)."""
        return np.any(self.by_torque, axis=0)

    @property
    def is_linear(self) -> bool:
        """Whether the errors are linear in the parameters."""
        return self.response is None and not self.by_torque.any()

    @cached_property
    def _bends(self) -> tuple[Array, Array]:
        """From each push to the next (R, J - 1): by how much it is larger, and by what factor the response is."""
        assert self.pushes is not None and self.response is not None
        steps = np.diff(self.pushes, axis=1)
        return steps, np.diff(self.response, axis=1) / steps

    def _error(self, theta: Array) -> tuple[Array, Array]:
        """Errors (R,) and the slopes of the equations by the torque (R,) there."""
        left, taken = (self.y - self.phi @ theta) / self.passed, self.by_torque @ theta
        if self.response is None or self.pushes is None:
            slope = np.maximum(1.0 - taken, LEAST_SLOPE)
            return left / slope, slope
        steps, bends = self._bends
        slopes = np.maximum(bends - taken[:, None], LEAST_SLOPE)  # (R, J - 1)
        balance = np.cumsum(np.column_stack([left, slopes * steps]), axis=1)  # at each push (R, J)
        balance += (left - balance[:, steps.shape[1] // 2])[:, None]
        rows, place = np.arange(len(left)), np.clip(np.sum(balance < 0, axis=1) - 1, 0, steps.shape[1] - 1)
        slope = slopes[rows, place]
        return balance[rows, place] / slope - self.pushes[rows, place], slope

    def solve(self, start: Array | None = None) -> Array:
        """Parameters (P,) of least squared error within the bounds, looked for from those of torque (P,) near them."""
        free = np.ones(self.phi.shape[1], dtype=bool)
        theta = np.zeros(len(free)) if start is None else start * self.of_torque
        return within_bounds(self._smaller()._solve, theta, free, self.least, self.most)[0]

    def least_squared(self) -> float:
        """Squared weighted error of the solution."""
        small = self._smaller()
        return float(np.sum((small.weights * small.error(small.solve())) ** 2))

    @property
    def unbent(self) -> Mask:
        """Equations that torque does not bend (R,), as of other joints than the one where it does."""
        plain = ~self.by_torque.any(axis=1)
        if self.pushes is not None:
            plain &= np.abs(self._bends[1] - 1.0).max(axis=1) < SOLVER.unbent
        return np.asarray(plain)

    def condensed(self, plain: Mask) -> Balance:
        """Fewer equations with the same solutions, those that are kept first.

        Equations that no torque bends, `plain` (R,), are as good as the triangle of their QR decomposition.
        """
        rows = np.column_stack([self.phi, self.y])[plain] * (self.weights / self.passed)[plain, None]
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        kept, ones = self[~plain], np.ones(len(triangle))
        zeros = np.zeros((len(triangle), self.phi.shape[1]))
        added = {"phi": triangle[:, :-1], "y": triangle[:, -1], "by_torque": zeros, "weights": ones, "passed": ones}
        if self.pushes is not None:
            added["response"] = added["pushes"] = np.tile(self.pushes.max(axis=0), (len(triangle), 1))
        kept = replace(kept, passed=np.broadcast_to(kept.passed, kept.y.shape), recorded=None)
        both: dict[str, Any] = {name: np.concatenate([getattr(kept, name), more]) for name, more in added.items()}
        return replace(kept, **both)

    @classmethod
    def of(cls, y: Array, weights: Array) -> Balance:
        """Equations of a left-hand side (R,) that no term explains yet, with weights (R,)."""
        return cls(np.empty((len(y), 0)), y, np.empty((len(y), 0)), np.empty(0), np.empty(0), weights)

    def beside(
        self, parts: Sequence[tuple[slice, Columns]], least: Array, most: Array, pushes: Array | None = None
    ) -> Balance:
        """The equations with the columns of more terms, each on some of them.

        Their parameters have the bounds `least` and `most`; `pushes` are of the torque (R, J), where a law is bent.
        """
        count = len(self.y)
        y, passed = self.y.copy(), np.broadcast_to(self.passed, count).copy()
        response, known = self.response, self.pushes
        for here, own in parts:
            y[here] -= own.fixed
            passed[here] *= own.passed
            if own.taken is not None and pushes is not None:
                response, known = (pushes if response is None else response).copy(), pushes
                response[here] -= own.taken
        return replace(
            self,
            phi=np.column_stack([self.phi, placed(count, [(here, own.linear) for here, own in parts])]),
            y=y,
            by_torque=np.column_stack([self.by_torque, placed(count, [(here, own.slope) for here, own in parts])]),
            least=np.append(self.least, least),
            most=np.append(self.most, most),
            response=response,
            pushes=known,
            passed=1.0 if (passed == 1.0).all() else passed,
            recorded=None,
        )

    def _smaller(self) -> Balance:
        """The same without what needs no iteration, where that is much."""
        plain = self.unbent
        if self.is_linear or np.count_nonzero(plain) <= 2 * self.phi.shape[1]:
            return self
        return self.condensed(plain)

    def solve_without(self, fold: Index, count: int) -> Array:
        """Parameters (K, P) as `solve` finds them without each of K folds, given the fold of every equation (R,).

        Each fold's normal equations are made once, around the whole fit, from which leaving out a fold leads a step
        away; what is solved is as small as they are.
        """
        near = self.tangent()
        rows = np.column_stack([near.error, near.slopes]) * self.weights[:, None]
        grams = np.array([own.T @ own for own in (rows[fold == k] for k in range(count))])
        found = np.empty((count, len(near.theta)))
        for k, gram in enumerate(without_each(grams)):
            step = solved(gram, self.least - near.theta, self.most - near.theta)
            if step is not None:
                found[k] = near.theta + step
                left = np.append(1.0, -step)
                if self.is_linear or self._is_as_foreseen(found[k], fold != k, float(left @ gram @ left)):
                    continue
            found[k] = self[fold != k].solve(near.theta)
        return found

    def _is_as_foreseen(self, theta: Array, rows: Mask, square: float) -> bool:
        """Whether parameters (P,) leave as little of some equations as a linear model of them foresaw.

        By so much less likely they are than those of the fit, or less.
        """
        left = float(np.sum((self.weights * self.error(theta))[rows] ** 2))
        return bool(np.count_nonzero(rows) * (left - square) < 2 * SOLVER.unlikelier * max(square, 1e-300))

    def fit(self, clusters: Index, jacobian: Array | None = None) -> Fit:
        """The solution with its covariance, see `solve`, linear in the errors of the predicted torque around it.

        A parameter at its bound is known there: it has no error of its own, and the others' are those beside it.
        """
        theta = self.solve()
        error, slopes = self.error(theta), self.slopes(theta, jacobian)
        free = (theta > self.least) & (theta < self.most)
        own, extra = slopes[:, : len(theta)][:, free], slopes[:, len(theta) :]
        fit = solve(Equations(own, own @ theta[free] + error), self.weights, clusters, extra)
        kept = np.flatnonzero(np.append(free, np.ones(extra.shape[1], dtype=bool)))
        covariance = np.zeros((len(theta) + extra.shape[1],) * 2)
        covariance[np.ix_(kept, kept)] = fit.covariance
        direction = np.zeros(len(theta))
        direction[free] = fit.worst_direction
        return Fit(theta, covariance, error, direction, fit.condition)

    def slopes(self, theta: Array, jacobian: Array | None = None) -> Array:
        """Derivatives (R, P) of the predicted torque at parameters (P,).

        Those by shape parameters follow, (R, P + S), where `jacobian` has the derivatives of phi theta by these (R, S).
        """
        error, slope = self._error(theta)
        passed = np.broadcast_to(self.passed, slope.shape)[:, None]
        own = self.phi / passed - error[:, None] * self.by_torque
        return np.column_stack([own, *([] if jacobian is None else [jacobian / passed])]) / slope[:, None]

    def tangent(self) -> Tangent:
        """The errors, linear around the fit; exactly so where they are linear, and then around zero."""
        theta = np.zeros(self.phi.shape[1]) if self.is_linear else self.solve()
        error, slope = self._error(theta)
        return Tangent(theta, error, self.slopes(theta), 1.0 / (slope * self.passed))

    def _solve(self, theta: Array, free: Mask) -> Array:
        """The parameters with the free ones moved to where the squared error is least (Gauss-Newton)."""
        plain, w = free & ~self.of_torque, self.weights
        theta = np.where(plain, 0.0, theta)
        slope = np.maximum(1.0 - self.by_torque @ theta, LEAST_SLOPE) * self.passed
        known = (self.y - self.phi @ theta) * w / slope
        theta[plain] = least_squares(self.phi[:, plain] * (w / slope)[:, None], known)
        if self.is_linear or not free.any():
            return theta
        error = w * self.error(theta)
        for _ in range(SOLVER.turns):
            slopes = w[:, None] * self.slopes(theta)
            step = np.zeros(len(theta))
            step[free] = least_squares(slopes[:, free], error)
            for share in SOLVER.shares:
                tried = w * self.error(theta + share * step)
                if tried @ tried < error @ error:
                    break
            else:
                break
            fell = 1.0 - float(tried @ tried) / float(error @ error)
            theta, error = theta + share * step, tried
            if fell < SOLVER.enough:
                break
        return theta


def placed(count: int, parts: Sequence[tuple[slice, Array]]) -> Array:
    """Columns side by side (R, P), each on its rows of R = `count` equations, zero elsewhere."""
    if all(len(own) == count for _, own in parts):
        return np.column_stack([np.empty((count, 0)), *(own for _, own in parts)])
    whole, first = np.zeros((count, sum(own.shape[1] for _, own in parts))), 0
    for here, own in parts:
        whole[here, first : (first := first + own.shape[1])] = own
    return whole


class Tangent(NamedTuple):
    """Errors of the predicted torque near some parameters, to first order.

    Attributes:
        theta: the parameters (P,).
        error: there (R,) [N m].
        slopes: by which errors fall with the parameters (R, P).
        scale: by which errors grow with the left-hand sides of the equations (R,).
    """

    theta: Array
    error: Array
    slopes: Array
    scale: Array


def within_bounds(
    solve: Callable[[Array, Mask], Array], theta: Array, free: Mask, least: Array, most: Array
) -> tuple[Array, Mask]:
    """Parameters (P,) that a solver finds, those that would leave their bounds held there; and which are free still.

    The solver gives the parameters with the free ones (P,) found anew. Those that leave at once are held at once, and
    none is let go again: of several bounds that act together, the solution is within all, if not always the very best.
    """
    while True:
        theta = solve(theta, free)
        bounded = np.clip(theta, least, most)
        leaves = free & (bounded != theta)
        if not leaves.any():
            return theta, free
        theta, free = np.where(leaves, bounded, theta), free & ~leaves


def without_each(grams: Array) -> Array:
    """Gram matrices of all folds but one, for each of K folds, given those of the folds (K, P + 1, P + 1)."""
    others = 1.0 - np.eye(len(grams))  # not the difference from the whole, which loses digits
    return np.asarray(np.einsum("lk,kij->lij", others, grams))


def solved(gram: Array, least: Array, most: Array) -> Array | None:
    """Parameters (P,) that solve normal equations within bounds, given the Gram matrix (P + 1, P + 1) of [y, phi].

    None where the equations hardly tell them apart, and normal equations lose too many digits.
    """
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1.0
    gram, size = gram / np.outer(size, size), size[1:] / size[0]
    phi, y = gram[1:, 1:], gram[1:, 0]
    if not len(size) or _factor(phi) is None:
        return None

    def solve(theta: Array, free: Mask) -> Array:
        theta = np.where(free, 0.0, theta)
        theta[free] = np.linalg.solve(phi[np.ix_(free, free)], (y - phi @ theta)[free])
        return theta

    free = np.ones(len(size), dtype=bool)
    return within_bounds(solve, np.zeros(len(size)), free, least * size, most * size)[0] / size


def quietest_most(squares: Array, counts: Index, least: float) -> Array:
    """Weight of each recording (E,) by the sum of its squared residuals (E,): the quietest counts most.

    Some may have no equations, by their counts (E,); below the level `least`, all are as quiet.
    """
    levels = np.maximum(np.sqrt(squares / np.maximum(counts, 1)), least) + 1e-300
    return np.where(counts > 0, levels[counts > 0].min() / levels, 0.0)


def information(covariance: Array) -> Array:
    """Inverse of a covariance (P, P); nothing is known of what has no variance, or in a direction that has none.

    A regression that cannot tell two parameters apart says nothing of their difference.
    """
    size = np.sqrt(np.diag(covariance))
    size[size == 0] = np.inf
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(covariance / scale, rcond=1e-10, hermitian=True) / scale)


def least_squares(phi: Array, y: Array) -> Array:
    """Parameters (P,) of least squared error, columns scaled to equal length first; zero for a column of zeros.

    Normal equations lose twice as many digits as the columns are alike by, and are used where that is few.
    """
    scale = np.linalg.norm(phi, axis=0)
    scale[scale == 0] = np.inf
    phi = phi / scale
    factor = _factor(phi.T @ phi) if phi.shape[1] else None
    if factor is not None:
        return np.asarray(dpotrs(factor, phi.T @ y)[0] / scale)
    return np.asarray(np.linalg.lstsq(phi, y, rcond=1e-10)[0] / scale)


def _factor(gram: Array) -> Array | None:
    """Cholesky factor of scaled normal equations (P, P); None where their least eigenvalue may be too small.

    It is at least the inverse of the largest absolute column sum of their inverse, which LAPACK estimates.
    """
    factor, fault = dpotrf(gram)
    size = float(np.abs(gram).sum(axis=0).max())
    return None if fault or size * dpocon(factor, size)[0] <= SOLVER.distinct else factor
