"""Equations of a torque balance with a regressor that may depend on the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from estimators.regression.gauss_newton import LocalErrors, StopRule, gauss_newton
from estimators.regression.least_squares import (
    SOLVER,
    Fit,
    compute_condition,
    compute_jackknife,
    reduce_to_triangle,
    solve_least_squares,
    solve_within_bounds,
    widen_covariance,
)
from estimators.regression.response import LEAST_SLOPE, TorqueResponse
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.physics.estimate import LARGEST


class Columns(NamedTuple):
    """Windowed columns of a term on the R rows of its joint, and their derivatives by the torque.

    Attributes:
        linear: column of each parameter (R, P).
        fixed: sum of the columns without a parameter (R,) [N m].
        slope: derivatives of `linear` by the torque (R, P) [1/(N m)]; zero for effects of motion alone.
        fixed_slope: derivative of `fixed` by the torque (R,).
        fixed_change: change of `fixed` under each torque perturbation (R, J) [N m], for an exact fit; None unless
            `fixed` is a function of the present torque.
        torque_share: norm of torque less `fixed` over the norm of torque, if a filter of torque lowers it; else one.
    """

    linear: Array
    fixed: Array
    slope: Array
    fixed_slope: Array | float = 0.0
    fixed_change: Array | None = None
    torque_share: float = 1.0


@dataclass(frozen=True)
class Balance:
    """Equations y = phi theta with a regressor that may depend on the torque, as with load-dependent friction.

    Least squares of y - phi theta would explain torque by torque. The error of an equation is therefore that of the
    torque predicted from the motion. It is minus the perturbation p of the recorded torque that satisfies

        y + response(p) = (phi + p by_torque) theta.

    Beyond a saturation no perturbation suffices, and the error is large.

    Attributes:
        phi: regressor (R, P).
        y: left-hand side (R,) [N m].
        by_torque: derivatives of the regressor by the torque (R, P) [1/(N m)].
        least, most: bounds of the fitted parameters (P,).
        weights: factor of each equation's error in a fit (R,).
        response: response to perturbations of the torque; None if all equations are linear in it.
        torque_share: product of `Columns.torque_share` of all terms, per equation (R,) or one number. Errors are
            divided by it, so a filter that only removes torque explains none of it.
        unfiltered: the equations solved for the recorded torque, if a term filters it; else None.
    """

    phi: Array
    y: Array
    by_torque: Array
    least: Array
    most: Array
    weights: Array
    response: TorqueResponse | None = None
    torque_share: float | Array = 1.0
    unfiltered: Balance | None = None

    def __getitem__(self, rows: Mask) -> Balance:
        """Return the equations of some rows (R,)."""
        names = "phi", "y", "by_torque", "weights", "response", "torque_share", "unfiltered"
        parts = ((name, getattr(self, name)) for name in names)
        chosen: dict[str, Any] = {
            name: part[rows] for name, part in parts if isinstance(part, np.ndarray | Balance | TorqueResponse)
        }
        return replace(self, **chosen)

    def error(self, theta: Array) -> Array:
        """Return the measured minus the predicted torque (R,) [N m] at parameters (P,)."""
        return self._compute_error(theta)[0]

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Return y - phi theta at K sets of parameters (K, P), and its derivative by the torque, (K, R) each.

        Their ratio is a small error of the predicted torque. The derivative is at least `SOLVER.tiny`.
        """
        slope = 1.0 - theta @ self.by_torque.T if self.of_torque.any() else np.ones((len(theta), len(self.y)))
        if self.response is not None:
            slope += self.response.slope - 1.0
        return self.y - theta @ self.phi.T, np.maximum(slope * self.torque_share, SOLVER.tiny)

    @property
    def reach(self) -> Array:
        """Half of the largest torque perturbation of each equation (R,) [N m]; infinite without perturbations."""
        return np.full(len(self.y), np.inf) if self.response is None else self.response.reach

    @cached_property
    def of_torque(self) -> Mask:
        """Mask of the parameters with columns that depend on the torque (P,)."""
        return np.any(self.by_torque, axis=0)

    @property
    def is_linear(self) -> bool:
        """Return whether the errors are linear in the parameters."""
        return self.response is None and not self.of_torque.any()

    def _compute_error(self, theta: Array) -> tuple[Array, Array]:
        """Return the errors (R,) and the slopes of the equations by the torque (R,)."""
        residual = (self.y - self.phi @ theta) / self.torque_share
        if self.is_linear:
            return np.clip(residual, -LARGEST, LARGEST), np.ones(len(residual))
        column_slope = self.by_torque[:, self.of_torque] @ np.compress(self.of_torque, theta)
        slope = np.maximum(1.0 - column_slope, LEAST_SLOPE)
        error = residual / slope
        if self.response is not None:
            has_slope = bool(self.of_torque.any())
            curved, errors, slopes = self.response.find_errors(residual, column_slope if has_slope else None)
            error[curved], slope[curved] = errors, slopes
        return np.clip(error, -LARGEST, LARGEST), slope

    def solve(self, start: Array | None = None) -> Array:
        """Fit parameters (P,) within their bounds by weighted least squares, from a start (P,), or from zero."""
        free = np.ones(self.phi.shape[1], dtype=bool)
        theta = np.zeros(len(free)) if start is None else start
        condensed = self if self.is_linear else condense_linear_rows(self)
        return solve_within_bounds(condensed._solve, theta, free, self.least, self.most)[0]

    def with_bounds(self, least: Array, most: Array) -> Balance:
        """Return the equations with other bounds of the parameters (P,)."""
        return replace(self, least=least, most=most)

    @classmethod
    def from_target(cls, y: Array, weights: Array) -> Balance:
        """Return equations without terms, of a left-hand side (R,) [N m] and weights (R,)."""
        return cls(np.empty((len(y), 0)), y, np.empty((len(y), 0)), np.empty(0), np.empty(0), weights)

    def with_columns(
        self, parts: Sequence[tuple[slice, Columns]], least: Array, most: Array, perturbations: Array | None = None
    ) -> Balance:
        """Return the equations with the columns of more terms, and without `unfiltered`.

        Args:
            parts: rows and columns of each added term.
            least, most: bounds of all parameters (P,), of the present and the added terms.
            perturbations: of the torque (R, J) [N m]; used if an added term has a `fixed_change`.
        """
        count = len(self.y)
        y, torque_share = self.y.copy(), np.broadcast_to(self.torque_share, count).copy()
        response = self.response
        for rows, columns in parts:
            y[rows] -= columns.fixed
            torque_share[rows] *= columns.torque_share
            if columns.fixed_change is not None and perturbations is not None:
                change = (perturbations if response is None else response.change).copy()
                change[rows] -= columns.fixed_change
                slope = np.ones(count) if response is None else response.slope.copy()
                slope[rows] -= columns.fixed_slope
                response = TorqueResponse(perturbations, change, slope)
        linear = place_columns(count, [(rows, columns.linear) for rows, columns in parts])
        slopes = np.zeros(linear.shape)
        if any(columns.slope.any() for _, columns in parts):
            slopes = place_columns(count, [(rows, columns.slope) for rows, columns in parts])
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
            torque_share=1.0 if (torque_share == 1.0).all() else torque_share,
            unfiltered=None,
        )

    def fit(self, clusters: Index, jacobian: Array | None = None, theta: Array | None = None) -> Fit:
        """Return the fit with the covariance of its parameters by the tangent, from clusters of residuals (R,).

        A parameter at its bound counts as known and has no error. `theta` (P,) is solved unless given. Derivatives of
        phi theta by nonlinear parameters, `jacobian` (R, S), extend the covariance to (P + S, P + S).
        """
        theta = self.solve() if theta is None else theta
        error, slopes = self.error(theta), self.slopes(theta, jacobian)
        free = (theta > self.least) & (theta < self.most)
        linear, nonlinear = slopes[:, : len(theta)][:, free], slopes[:, len(theta) :]
        weighted = np.column_stack([linear, nonlinear]) * self.weights[:, None]
        condition = compute_condition(weighted[:, : linear.shape[1]])
        with_error = np.flatnonzero(np.append(free, np.ones(nonlinear.shape[1], dtype=bool)))
        covariance = np.zeros((len(theta) + nonlinear.shape[1],) * 2)
        variances, freedom_of_free = compute_jackknife(weighted, error * self.weights, clusters)
        covariance[np.ix_(with_error, with_error)] = widen_covariance(variances, freedom_of_free)
        freedom = np.zeros(len(theta))
        freedom[free] = freedom_of_free[: linear.shape[1]]
        return Fit(theta, covariance, error, condition, freedom)

    def slopes(self, theta: Array, jacobian: Array | None = None) -> Array:
        """Return derivatives of the predicted torque by the parameters (R, P), at parameters (P,).

        `jacobian` (R, S), derivatives of phi theta by nonlinear parameters, adds derivatives by these (R, P + S).
        """
        return self._linearise_errors(theta, jacobian)[1]

    def _linearise_errors(self, theta: Array, jacobian: Array | None = None) -> tuple[Array, Array]:
        """Return the errors (R,) and `slopes`, (R, P) or (R, P + S)."""
        error, slope = self._compute_error(theta)
        torque_share = np.broadcast_to(self.torque_share, slope.shape)[:, None]
        if self.is_linear and jacobian is None:
            return error, self.phi / torque_share
        linear = self.phi / torque_share - error[:, None] * self.by_torque
        derivatives = linear if jacobian is None else np.column_stack([linear, jacobian / torque_share])
        return error, derivatives / slope[:, None]

    def linearise(self, theta: Array | None = None) -> Tangent:
        """Linearise the errors around parameters (P,), by default the fit; linear errors around zero."""
        if self.is_linear:
            theta = np.zeros(self.phi.shape[1])
        elif theta is None:
            theta = self.solve()
        error, slope = self._compute_error(theta)
        return Tangent(theta, error, self.slopes(theta), 1.0 / (slope * self.torque_share))

    def _solve(self, theta: Array, free: Mask) -> Array:
        """Fit the free parameters by Gauss-Newton from `theta` (P,), and keep the others; bounds are not applied.

        If all parameters of motion alone start from zero, they are first solved by linear least squares.
        """
        of_motion, w = free & ~self.of_torque, self.weights
        if self.is_linear or not theta[of_motion].any():
            theta = np.where(of_motion, 0.0, theta)
            slope = np.maximum(1.0 - self.by_torque @ theta, LEAST_SLOPE) * self.torque_share
            target = (self.y - self.phi @ theta) * w / slope
            theta[of_motion] = solve_least_squares(self.phi[:, of_motion] * (w / slope)[:, None], target)
        if self.is_linear or not free.any():
            return theta

        def linearise(theta: Array) -> LocalErrors[Array]:  # slopes of the free parameters alone
            errors, slopes = self._linearise_errors(theta)
            error = w * errors
            return LocalErrors(theta, float(error @ error), error, -w[:, None] * slopes[:, free])

        def choose_step(
            local: LocalErrors[Array], steps: list[Array]
        ) -> tuple[Array, float]:  # first share that lowers the cost
            step = np.zeros(len(local.known))
            step[free] = steps[0]
            for share in SOLVER.shares:
                trial = local.known + share * step
                cost = float(np.sum((w * self.error(trial)) ** 2))
                if cost < local.cost:
                    break
            return trial, cost

        return gauss_newton(theta, linearise, choose_step, StopRule(SOLVER.iterations, of_cost=SOLVER.enough))


def condense(balance: Balance, is_linear: Mask, slopes: Array, target: Array) -> Balance:
    """Replace L equations by at most P + 1 with the same least-squares solution, after the other equations.

    Nonlinear equations are replaced by their tangent; the solution then holds near its point. The new equations contain
    the weights, so their weight and torque share are one. With perturbations, their response is linear.

    Args:
        balance: equations.
        is_linear: mask of the L replaced equations (R,).
        slopes: derivatives of their predicted torque by the parameters (L, P), divided by the torque share.
        target: their left-hand sides: `slopes` times the parameters plus the error (L,) [N m].
    """
    triangle = reduce_to_triangle(slopes * balance.weights[is_linear, None], target * balance.weights[is_linear])
    others, ones = balance[~is_linear], np.ones(len(triangle))
    zeros = np.zeros((len(triangle), balance.phi.shape[1]))
    added = {"phi": triangle[:, :-1], "y": triangle[:, -1], "by_torque": zeros, "weights": ones, "torque_share": ones}
    others = replace(others, torque_share=np.broadcast_to(others.torque_share, others.y.shape), unfiltered=None)
    joined_arrays: dict[str, Any] = {
        name: np.concatenate([getattr(others, name), values]) for name, values in added.items()
    }
    if others.response is not None and balance.response is not None:
        largest = np.tile(balance.response.perturbations.max(axis=0), (len(triangle), 1))
        joined_arrays["response"] = TorqueResponse.join([others.response, TorqueResponse(largest, largest, ones)])
    return replace(others, **joined_arrays)


def condense_linear_rows(balance: Balance) -> Balance:
    """Condense the linear equations to as many as needed, if more than 2 P; the solutions stay equal."""
    is_linear: Mask = np.asarray(~balance.by_torque.any(axis=1))
    if balance.response is not None:
        is_linear[balance.response.slopes[0]] = False
    if np.count_nonzero(is_linear) <= 2 * balance.phi.shape[1]:
        return balance
    share = np.broadcast_to(balance.torque_share, is_linear.shape)[is_linear]
    return condense(balance, is_linear, balance.phi[is_linear] / share[:, None], balance.y[is_linear] / share)


def compute_least_square(balance: Balance) -> float:
    """Return the sum of the squared weighted errors at the solution [(N m)^2]."""
    condensed = balance if balance.is_linear else condense_linear_rows(balance)
    return float(np.sum((condensed.weights * condensed.error(condensed.solve())) ** 2))


def place_columns(count: int, parts: Sequence[tuple[slice, Array]]) -> Array:
    """Place columns side by side (R, P), each on its rows of R = `count` equations, zero elsewhere.

    Columns that all have R rows keep them; their slices are not read.
    """
    if all(len(columns) == count for _, columns in parts):
        return np.column_stack([np.empty((count, 0)), *(columns for _, columns in parts)])
    placed, first = np.zeros((count, sum(columns.shape[1] for _, columns in parts))), 0
    for rows, columns in parts:
        placed[rows, first : (first := first + columns.shape[1])] = columns
    return placed


class Tangent(NamedTuple):
    """Errors of the predicted torque near some parameters, to first order: error - slopes (parameters - theta).

    Attributes:
        theta: the parameters (P,).
        error: errors at these parameters (R,) [N m].
        slopes: derivatives of the predicted torque by the parameters (R, P).
        scale: derivatives of the errors by the left-hand sides of the equations (R,).
    """

    theta: Array
    error: Array
    slopes: Array
    scale: Array

    @property
    def target(self) -> Array:
        """Return the left-hand side of the linear regression on `slopes` (R,) [N m]."""
        return self.error + self.slopes @ self.theta
