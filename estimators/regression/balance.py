"""Equations of a torque balance, in which the torque that they explain may stand on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from estimators.regression.gauss_newton import Near, Rule, gauss_newton
from estimators.regression.least_squares import (
    SOLVER,
    Fit,
    compute_robust_covariance,
    find_worst_direction,
    solve_gram,
    solve_least_squares,
    solve_within_bounds,
    sum_without_each,
    triangle_of,
)
from pendulum_env._typing import Array, Index, Mask

LEAST_SLOPE = 0.05  # of an equation by the torque, so that an error stays finite


class Columns(NamedTuple):
    """Windowed columns of a term on the R rows of its joint, and their slopes by the torque.

    Attributes:
        linear: (R, P).
        fixed: sum of the columns without a parameter (R,) [N m].
        slope: of the linear ones (R, P) [1/(N m)], zero except for effects that depend on the torque.
        fixed_slope: of the fixed ones (R,), the same.
        fixed_change: of the fixed ones under each perturbation of the torque (R, J), if they depend on it at once, for
            an exact fit.
        torque_share: share of the torque that they leave, if they depend on what it was before.
    """

    linear: Array
    fixed: Array
    slope: Array
    fixed_slope: Array | float = 0.0
    fixed_change: Array | None = None
    torque_share: float = 1.0


@dataclass(frozen=True)
class Balance:
    """Equations y = phi theta in which the torque that they explain may stand on both sides, as where friction grows
    with the load.

    Least squares would then explain torque by torque rather than by motion. What counts is the error of the torque that
    a model predicts from the motion: of the perturbation p of the recorded torque under which an equation would hold,

        y + response(p) = (phi + p by_torque) theta,

    exactly, for a nonlinear response as well. Beyond a saturation no perturbation suffices, and the error is large.

    Attributes:
        phi: regressor (R, P).
        y: left-hand side (R,) [N m].
        by_torque: slopes of the regressor by the torque (R, P) [1/(N m)].
        response: by which the left-hand side grows when the torque does, (R, J); the torque itself if not given.
        perturbations: of the torque in each equation (R, J) [N m], increasing, zero in their middle.
        least, most: bounds of the parameters (P,); one that would leave them stays at the bound.
        weights: of the equations in a fit (R,).
        torque_share: share of the torque that laws with memory leave, of each equation (R,) or of all; a law that only
            removes torque explains none of it.
        unfiltered: the same equations solved for the recorded torque, where torque acts through a filter; a filter that
            only removes torque explains none of it.
    """

    phi: Array
    y: Array
    by_torque: Array
    least: Array
    most: Array
    weights: Array
    response: Array | None = None
    perturbations: Array | None = None
    torque_share: float | Array = 1.0
    unfiltered: Balance | None = None

    def __getitem__(self, rows: Mask) -> Balance:
        names = "phi", "y", "by_torque", "weights", "response", "perturbations", "torque_share", "unfiltered"
        parts = ((name, getattr(self, name)) for name in names)
        chosen: dict[str, Any] = {name: part[rows] for name, part in parts if isinstance(part, np.ndarray | Balance)}
        return replace(self, **chosen)

    def error(self, theta: Array) -> Array:
        """Return the measured minus the predicted torque (R,) [N m] at parameters (P,)."""
        return self._error(theta)[0]

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Return the residuals at K sets of parameters (K, P), and their derivatives by the torque, (K, R) each.

        Their ratio is the error of the predicted torque, while that is small.
        """
        slope = 1.0 - theta @ self.by_torque.T if self.of_torque.any() else np.ones((len(theta), len(self.y)))
        bent, steps, bends = self._response_slopes
        middle = steps.shape[1] // 2
        slope[:, bent] += 0.5 * bends[:, middle - 1 : middle + 1].sum(axis=1) - 1.0
        return self.y - theta @ self.phi.T, np.maximum(slope * self.torque_share, SOLVER.tiny)

    @property
    def reach(self) -> Array:
        """Largest error of the predicted torque that is told from a larger one, of each equation (R,) [N m]."""
        return np.full(len(self.y), np.inf) if self.perturbations is None else 0.5 * self.perturbations[:, -1]

    @cached_property
    def of_torque(self) -> Mask:
        """Which parameters' columns depend on the torque (P,)."""
        return np.any(self.by_torque, axis=0)

    @property
    def is_linear(self) -> bool:
        """Return whether the errors are linear in the parameters."""
        return self.response is None and not self.of_torque.any()

    @cached_property
    def _response_slopes(self) -> tuple[Index, Array, Array]:
        """Equations whose response is not the torque itself (B,), and steps of perturbations with slopes (B, J - 1)."""
        if self.perturbations is None or self.response is None:
            return np.empty(0, dtype=np.intp), np.empty((0, 0)), np.empty((0, 0))
        steps = np.diff(self.perturbations, axis=1)
        slopes = np.diff(self.response, axis=1) / steps
        bent = np.flatnonzero(np.abs(slopes - 1.0).max(axis=1) >= SOLVER.linear_response)
        return bent, steps[bent], slopes[bent]

    @cached_property
    def _steady_changes(self) -> tuple[Array, Array]:
        """Slopes and changes of these equations where no column depends on the torque, see `_bend`."""
        bent, steps, bends = self._response_slopes
        return _bend(steps, bends, np.zeros(len(bent)))

    def _error(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors (R,) and the slopes of the equations by the torque (R,)."""
        left = (self.y - self.phi @ theta) / self.torque_share
        if self.is_linear:
            return left, np.ones(len(left))
        response_slope = self.by_torque[:, self.of_torque] @ np.compress(self.of_torque, theta)
        slope = np.maximum(1.0 - response_slope, LEAST_SLOPE)
        error, (bent, steps, bends) = left / slope, self._response_slopes
        if self.perturbations is None or not len(bent):
            return error, slope
        slopes, changes = (
            self._steady_changes if not self.of_torque.any() else _bend(steps, bends, response_slope[bent])
        )
        place = np.clip(np.count_nonzero(changes < -left[bent, None], axis=1) - 1, 0, steps.shape[1] - 1)
        rows = np.arange(len(bent))
        slope[bent] = slopes[rows, place]
        error[bent] = (left[bent] + changes[rows, place]) / slope[bent] - self.perturbations[bent, place]
        return error, slope

    def solve(self, start: Array | None = None) -> Array:
        """Fit parameters (P,) within their bounds, from a start (P,) near them if one is given."""
        free = np.ones(self.phi.shape[1], dtype=bool)
        theta = np.zeros(len(free)) if start is None else start
        return solve_within_bounds(_condense_linear_rows(self)._solve, theta, free, self.least, self.most)[0]

    def with_bounds(self, least: Array, most: Array) -> Balance:
        """Return the equations with other bounds of the parameters (P,)."""
        return replace(self, least=least, most=most)

    def least_squared(self) -> float:
        """Return the squared weighted error of the solution."""
        small = _condense_linear_rows(self)
        return float(np.sum((small.weights * small.error(small.solve())) ** 2))

    @classmethod
    def from_target(cls, y: Array, weights: Array) -> Balance:
        """Return equations of a left-hand side (R,) without terms, with weights (R,)."""
        return cls(np.empty((len(y), 0)), y, np.empty((len(y), 0)), np.empty(0), np.empty(0), weights)

    def with_columns(
        self, parts: Sequence[tuple[slice, Columns]], least: Array, most: Array, perturbations: Array | None = None
    ) -> Balance:
        """Return the equations with the columns of more terms, each on some of them.

        Args:
            parts: rows and columns of each term.
            least, most: bounds of all parameters: those of a term may depend on the others.
            perturbations: of the torque (R, J), for nonlinear laws of it.
        """
        count = len(self.y)
        y, torque_share = self.y.copy(), np.broadcast_to(self.torque_share, count).copy()
        response, known = self.response, self.perturbations
        for here, own in parts:
            y[here] -= own.fixed
            torque_share[here] *= own.torque_share
            if own.fixed_change is not None and perturbations is not None:
                response, known = (perturbations if response is None else response).copy(), perturbations
                response[here] -= own.fixed_change
        linear = place_columns(count, [(here, own.linear) for here, own in parts])
        slopes = np.zeros(linear.shape)
        if any(own.slope.any() for _, own in parts):
            slopes = place_columns(count, [(here, own.slope) for here, own in parts])
        if self.phi.shape[1]:
            linear, slopes = np.column_stack([self.phi, linear]), np.column_stack([self.by_torque, slopes])
        return replace(
            self,
            phi=linear,
            y=y,
            by_torque=slopes,
            least=least,
            most=most,
            response=response,
            perturbations=known,
            torque_share=1.0 if (torque_share == 1.0).all() else torque_share,
            unfiltered=None,
        )

    def solve_without(self, fold: Index, count: int, theta: Array | None = None) -> Array:
        """Fit parameters (K, P) without each of K folds; `theta` (P,), the whole fit, is solved unless given.

        Each fold's normal equations are made once, around the whole fit. The fit without a fold is one step from there.
        """
        near = self.tangent(theta)
        rows = np.column_stack([near.error, near.slopes]) * self.weights[:, None]
        grams = np.array([own.T @ own for own in (rows[fold == k] for k in range(count))])
        found = np.empty((count, len(near.theta)))
        for k, gram in enumerate(sum_without_each(grams)):
            step = solve_gram(gram, self.least - near.theta, self.most - near.theta)
            if step is not None:
                found[k] = near.theta + step
                left = np.append(1.0, -step)
                if self.is_linear or self.fits_tangent(found[k], fold != k, float(left @ gram @ left)):
                    continue
            found[k] = self[fold != k].solve(near.theta)
        return found

    def fits_tangent(self, theta: Array, rows: Mask, square: float) -> bool:
        """Return whether the squared error of some equations at parameters (P,) is about that of the tangent."""
        left = float(np.sum((self.weights * self.error(theta))[rows] ** 2))
        return bool(np.count_nonzero(rows) * abs(left - square) < 2 * SOLVER.unlikelier * max(square, 1e-300))

    def fit(self, clusters: Index, jacobian: Array | None = None, theta: Array | None = None) -> Fit:
        """Return the fit with the covariance of its parameters, by the tangent; `theta` (P,) is solved unless given.

        A parameter at its bound is known there: it has no error of its own, and the others' are those beside it.
        """
        theta = self.solve() if theta is None else theta
        error, slopes = self.error(theta), self.slopes(theta, jacobian)
        free = (theta > self.least) & (theta < self.most)
        own, extra = slopes[:, : len(theta)][:, free], slopes[:, len(theta) :]
        weighted = np.column_stack([own, extra]) * self.weights[:, None]
        condition, worst = find_worst_direction(weighted[:, : own.shape[1]])
        kept = np.flatnonzero(np.append(free, np.ones(extra.shape[1], dtype=bool)))
        covariance = np.zeros((len(theta) + extra.shape[1],) * 2)
        covariance[np.ix_(kept, kept)] = compute_robust_covariance(weighted, error * self.weights, clusters)
        direction = np.zeros(len(theta))
        direction[free] = worst
        return Fit(theta, covariance, error, direction, condition)

    def slopes(self, theta: Array, jacobian: Array | None = None) -> Array:
        """Return derivatives (R, P) of the predicted torque at parameters (P,).

        Those by nonlinear parameters follow, (R, P + S); `jacobian` (R, S) has the derivatives of phi theta by these.
        """
        return self._linear(theta, jacobian)[1]

    def _linear(self, theta: Array, jacobian: Array | None = None) -> tuple[Array, Array]:
        """Return the errors (R,) and these derivatives."""
        error, slope = self._error(theta)
        torque_share = np.broadcast_to(self.torque_share, slope.shape)[:, None]
        if self.is_linear and jacobian is None:
            return error, self.phi / torque_share
        own = self.phi / torque_share - error[:, None] * self.by_torque
        whole = own if jacobian is None else np.column_stack([own, jacobian / torque_share])
        return error, whole / slope[:, None]

    def tangent(self, theta: Array | None = None) -> Tangent:
        """Linearise the errors around the fit (P,), solved unless given, or around zero where they are linear."""
        if self.is_linear:
            theta = np.zeros(self.phi.shape[1])
        elif theta is None:
            theta = self.solve()
        error, slope = self._error(theta)
        return Tangent(theta, error, self.slopes(theta), 1.0 / (slope * self.torque_share))

    def _solve(self, theta: Array, free: Mask) -> Array:
        """Fit the free parameters by Gauss-Newton, and keep the others."""
        plain, w = free & ~self.of_torque, self.weights
        if self.is_linear or not theta[plain].any():  # those have no start
            theta = np.where(plain, 0.0, theta)
            slope = np.maximum(1.0 - self.by_torque @ theta, LEAST_SLOPE) * self.torque_share
            known = (self.y - self.phi @ theta) * w / slope
            theta[plain] = solve_least_squares(self.phi[:, plain] * (w / slope)[:, None], known)
        if self.is_linear or not free.any():
            return theta

        def near(theta: Array) -> Near[Array]:
            left, slopes = self._linear(theta)
            error = w * left
            return Near(theta, float(error @ error), error, -w[:, None] * slopes[:, free])

        def best(near: Near[Array], steps: list[Array]) -> tuple[Array, float]:
            step = np.zeros(len(near.known))
            step[free] = steps[0]
            for share in SOLVER.shares:  # the whole step, most of the time
                found = near.known + share * step
                cost = float(np.sum((w * self.error(found)) ** 2))
                if cost < near.cost:
                    break
            return found, cost

        return gauss_newton(theta, near, best, Rule(SOLVER.turns, of_cost=SOLVER.enough))


def _bend(steps: Array, bends: Array, response_slope: Array) -> tuple[Array, Array]:
    """Return the slopes of equations between perturbations (B, J - 1), and their changes up to each of these (B, J).

    Args:
        steps: of the perturbations (B, J - 1).
        bends: slopes of the responses there (B, J - 1).
        response_slope: slopes of the columns by the torque (B,), times their parameters.
    """
    slopes = np.maximum(bends - response_slope[:, None], LEAST_SLOPE)
    changes = np.cumsum(np.column_stack([np.zeros(len(steps)), slopes * steps]), axis=1)
    return slopes, changes - changes[:, [steps.shape[1] // 2]]


def find_linear_rows(balance: Balance) -> Mask:
    """Find the equations without a law of the torque (R,), such as those of other joints."""
    plain: Mask = np.asarray(~balance.by_torque.any(axis=1))
    plain[balance._response_slopes[0]] = False
    return plain


def condense(balance: Balance, plain: Mask, slopes: Array, target: Array) -> Balance:
    """Return fewer equations with the same solutions, those that are kept first.

    Linear equations are equivalent to the triangle of their QR decomposition, by normal equations where these suffice.

    Args:
        balance: equations.
        plain: which are linear, or taken for their tangent (R,).
        slopes: of what these predict by the parameters (L, P).
        target: what they predict at the fit (L,) [N m].
    """
    triangle = triangle_of(slopes * balance.weights[plain, None], target * balance.weights[plain])
    kept, ones = balance[~plain], np.ones(len(triangle))
    zeros = np.zeros((len(triangle), balance.phi.shape[1]))
    added = {"phi": triangle[:, :-1], "y": triangle[:, -1], "by_torque": zeros, "weights": ones, "torque_share": ones}
    if balance.perturbations is not None:
        added["response"] = added["perturbations"] = np.tile(balance.perturbations.max(axis=0), (len(triangle), 1))
    kept = replace(kept, torque_share=np.broadcast_to(kept.torque_share, kept.y.shape), unfiltered=None)
    both: dict[str, Any] = {name: np.concatenate([getattr(kept, name), more]) for name, more in added.items()}
    return replace(kept, **both)


def _condense_linear_rows(balance: Balance) -> Balance:
    """Return equations with the same solutions, with many linear ones condensed: they need no iteration."""
    if balance.is_linear or np.count_nonzero(plain := find_linear_rows(balance)) <= 2 * balance.phi.shape[1]:
        return balance
    share = np.broadcast_to(balance.torque_share, plain.shape)[plain]
    return condense(balance, plain, balance.phi[plain] / share[:, None], balance.y[plain] / share)


def place_columns(count: int, parts: Sequence[tuple[slice, Array]]) -> Array:
    """Place columns side by side (R, P), each on its rows of R = `count` equations, zero elsewhere."""
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

    @property
    def target(self) -> Array:
        """Return the prediction of the slopes at the fit (R,) [N m]."""
        return self.error + self.slopes @ self.theta
