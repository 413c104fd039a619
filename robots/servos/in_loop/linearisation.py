"""Errors of rollouts around a point, to first order in the parameters, whose steps are relative to their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.memoize import memoized
from estimators.search_hints import find_hints
from estimators.weak_form.columns import list_bounds
from estimators.weak_form.nonlinear import list_continuous_parameters
from estimators.weak_form.point import Point
from estimators.weak_form.rows import Terms
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.physics.term import return_zero
from robots.servos.in_loop.likelihood import compute_error_scales
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP


@dataclass(frozen=True)
class LinearErrors:
    """Errors of rollouts around a point, to first order.

    Attributes:
        point: terms and parameters.
        error: simulated minus measured positions (R,) [rad].
        slopes: its derivatives by all free parameters, linear ones first (R, P + S).
        weights: square roots of the weights of the errors (R,).
    """

    point: Point
    error: Array
    slopes: Array
    weights: Array


@dataclass(eq=False)
class TypicalSizes:
    """Sizes of linear parameters, whose torque is the share `LOOP.fit.typical` of the RMS recorded torque.

    Attributes:
        torque: rows of the recorded torque.
    """

    torque: TorqueRows

    def list_sizes(self, terms: Terms) -> Array:
        """Return the size of each linear parameter of some terms (P,)."""
        return np.concatenate([np.empty(0), *(self.compute_sizes(term) for term in terms)])

    @memoized
    def compute_sizes(self, term: Term) -> Array:
        """Return the size of each linear parameter of a term (P,)."""
        rms = np.sqrt(np.mean(self.torque.data.torque.recorded**2))
        column_rms = np.sqrt(np.mean(self.torque.data.columns([term])[0][0] ** 2, axis=0))
        columns = self.torque.data.window_columns
        (x,) = columns.trace([term])  # windows omit slow motion, in which friction may be largest
        peaks = [np.max(np.abs(column.force(x) + column.dry(x) * np.sign(x.velocity))) for column in term.columns]
        return np.asarray(LOOP.fit.typical * rms / np.maximum(np.maximum(column_rms, peaks), 1e-9))


def compute_parameter_sizes(point: Point, typical: Array) -> Array:
    """Return the size of each free parameter, to which its changes are relative (P + S,).

    It is the absolute value; for a linear parameter, it is at least the typical size (P,). With a play, the typical
    size of a mass is limited to the largest mass; otherwise secants make the inertia less than that of the link.
    """
    values = np.abs(point.values)
    count = len(point.theta)
    if has_local_minima(point.terms):
        is_mass = np.array([column.mass is not return_zero for term in point.terms for column in term.columns])
        heaviest = np.max(values[:count], where=is_mass, initial=0.0)
        typical = np.where(is_mass & (heaviest > 0), np.minimum(typical, heaviest), typical)
    values[:count] = np.maximum(values[:count], typical)
    return np.maximum(values, 1e-9)


def has_local_minima(terms: Sequence[Term]) -> bool:
    """Return whether the likelihood has many local minima over a nonlinear parameter of a term."""
    return any(find_hints(type(term)).profiled for term in terms)


def linearise_errors(
    rollouts: Rollouts,
    point: Point,
    typical: Array,
    nonlinear: bool,
    length: float | None = None,
    error: Array | None = None,
) -> LinearErrors:
    """Linearise the errors around a point by linear parameters, and by nonlinear parameters if they are free.

    `typical` is the size of each linear parameter that matters (P,). Slopes are those of steps of relative `length`. If
    the likelihood has many local minima, slopes for a nonlinear fit are those of secants to either side. `error` are
    the errors at the point (R,) [rad], if they are known.
    """
    has_minima = nonlinear and has_local_minima(point.terms)
    length = length or (LOOP.fit.secants if has_minima else LOOP.fit.differences)[-1]
    values, size = point.values, compute_parameter_sizes(point, typical)
    count = len(values) if nonlinear else len(point.theta)
    low, high = (end[:count] for end in find_bounds(point))
    current, is_moved = values[:count], np.eye(count, len(values), dtype=bool)
    steps = length * size[:count]
    steps = np.where(current + steps > high, -steps, steps)  # into the bounds
    ends = [current + steps]
    if has_minima:
        ends = [np.clip(current + sign * length * size[:count], low, high) for sign in (1, -1)]
        steps = np.maximum(ends[0] - ends[1], 1e-300)  # none of a known parameter
    nearby = [
        bind_terms(point.with_values(np.where(is_changed, value, values)))
        for end in ends
        for is_changed, value in zip(is_moved, end, strict=True)
    ]
    smooth = rollouts.without_counts  # counts have no slopes
    if error is not None and smooth is rollouts:
        errors = np.column_stack([error, smooth.compute_position_errors(nearby)])
    else:
        errors = smooth.compute_position_errors([point, *nearby])
    below = errors[:, :1] if len(ends) == 1 else errors[:, count + 1 :]
    slopes = (errors[:, 1 : count + 1] - below) / steps  # zero by known parameters, which `Point.with_values` keeps
    error = errors[:, 0].copy() if smooth is rollouts else rollouts.compute_position_errors([point])[:, 0]
    scale = compute_error_scales(rollouts, error[:, None])[0]
    least = rollouts.encoder_step or 1e-6 * scale  # counts have no smaller error, and steps would be too short
    relative = np.pi / 2 * np.maximum(np.abs(error), least) / scale
    weights = np.pi / 2 / scale * np.sqrt(np.tanh(relative) / relative)
    return LinearErrors(point, error, slopes, weights)


def find_bounds(point: Point) -> tuple[Array, Array]:
    """Return the bounds of each free parameter, (P + S,) each."""
    free = [p for term in point.terms for p in list_continuous_parameters(term)]
    lower, upper = list_bounds(point.terms)
    return np.r_[lower, [p.low for p in free]], np.r_[upper, [p.high for p in free]]


def bind_terms(point: Point) -> Point:
    """Bind nonlinear parameters of a point to bounds that depend on the linear ones."""
    return point._replace(terms=tuple(term.bind(point.linear_values) for term in point.terms))
