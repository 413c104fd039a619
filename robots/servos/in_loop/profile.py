"""Profile likelihood of a nonlinear parameter over which the likelihood of rollouts has many local minima.

All other parameters are fitted at several values of the parameter, each from the fit at a neighbouring value. A fit
ends in a local minimum near the likeliest point, so its maximum has an error. A parabola through the maxima,

    log L = c + b x - a x^2,     x the logarithm of the parameter,

averages over these errors. Its vertex b / 2a is the estimate. The variance is F / 2a, with the factor F by which
correlated errors widen the interval, plus the variance of the vertex by the scatter of the maxima. With an encoder at
the output, the error of a gap is at least the resolution: the controller sees no motion within a count.

Source: Ionides et al., Monte Carlo profile confidence intervals for dynamic systems, J. R. Soc. Interface 14, 2017.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from estimators.regression.least_squares import compute_robust_covariance
from estimators.search_hints import find_hints
from estimators.weak_form.nonlinear import list_continuous_parameters
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.physics.limits import limit_term
from robots.servos.in_loop.fit import fit_rollouts
from robots.servos.in_loop.likelihood import compute_log_likelihood
from robots.servos.in_loop.linearisation import LinearErrors, linearise_errors
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP


@dataclass(frozen=True)
class LikelihoodProfile:
    """Profile likelihood of a parameter.

    Attributes:
        name: of the parameter, `id.parameter`.
        point: fit at the estimate.
        variance: of the estimate.
        slopes: change of each free parameter with the estimate (P + S,).
    """

    name: str
    point: Point
    variance: float
    slopes: Array


def scan_profile(rollouts: Rollouts, start: Point, typical: Array) -> LikelihoodProfile | None:
    """Refit a model by the profile likelihood of a parameter with many local minima; None if it has none.

    Args:
        rollouts: to fit.
        start: of the first fit, of all parameters.
        typical: size of each linear parameter that matters (P,).
    """
    free = [(term, parameter) for term in start.terms for parameter in list_continuous_parameters(term)]
    is_sought = [p.name == find_hints(type(term)).profiled and p.low < p.high for term, p in free]
    if not any(is_sought):
        return None
    term, parameter = free[is_sought.index(True)]
    name, place = term.get_full_name(parameter.name), len(start.theta) + is_sought.index(True)
    scan = _ProfileScan(rollouts, typical, name, parameter.low, parameter.high)
    first = _leave_local_minima(rollouts, scan.fit_from(start), typical)
    scan.store(float(first.point.values[place]), first)
    near, best_value = scan.choose_values()

    def release(point: Point) -> Point:
        """Return the point with the parameter free."""
        pairs = zip(start.terms, point.terms, strict=True)
        return Point(tuple(replace(old, **new.nonlinear_values) for old, new in pairs), point.theta)

    best = linearise_errors(rollouts, release(scan.fits[best_value].point), typical, nonlinear=True)
    heights = np.array([scan.heights[value] for value in near])
    log_value, variance = fit_parabola(np.log(near), heights, _compute_widening(rollouts, best, place))
    estimate = float(np.exp(log_value))
    closest = min(near, key=lambda value: abs(np.log(value / estimate)))
    last = scan.fit_from(scan.fits[closest].point, estimate).point
    values = [scan.fits[value].point.named_values for value in near]  # a parameter at zero may be none
    paths = np.array([[by_name.get(text, 0.0) for text in last.named_values] for by_name in values])
    shifts = np.array(near) - np.mean(near)
    slopes = shifts @ (paths - paths.mean(axis=0)) / (shifts @ shifts)
    # a controller that reads counts at the output does not see motion of the motor within a count
    in_counts = rollouts.noise.resolution if parameter.unit == "rad" and rollouts.servos.at_output else 0.0
    return LikelihoodProfile(name, release(last), variance * estimate**2 + in_counts**2, slopes)


@dataclass(eq=False)
class _ProfileScan:
    """Fits at several values of the parameter `name`, which lies between `low` and `high`.

    Attributes:
        fits: likeliest fit at each value.
        heights: log likelihood of this fit [nat].
    """

    rollouts: Rollouts
    typical: Array
    name: str
    low: float
    high: float
    fits: dict[float, LinearErrors] = field(default_factory=dict)
    heights: dict[float, float] = field(default_factory=dict)
    _starts: dict[tuple[float, float], LinearErrors] = field(default_factory=dict)  # of fits, by value and neighbour

    def fit_from(self, start: Point, value: float | None = None) -> LinearErrors:
        """Fit all parameters from a start, with the parameter at a value if given."""
        limits = {self.name: (value, value)} if value is not None else None
        terms = start.terms if limits is None else [limit_term(term, limits) for term in start.terms]
        start = Point.from_parameters(terms, start.theta)
        return fit_rollouts(self.rollouts, start, self.typical, nonlinear=True, share=0.0)

    def store(self, value: float, fit: LinearErrors) -> None:
        """Store a fit at a value if it is likelier than the stored one."""
        height = float(compute_log_likelihood(self.rollouts, fit.error))
        if height > self.heights.get(value, -np.inf):
            self.fits[value], self.heights[value] = fit, height

    def extend(self, value: float, neighbour: float) -> None:
        """Fit at a value from the fit at a neighbour, unless this was done before."""
        start = self.fits[neighbour]
        if value != neighbour and self._starts.get((value, neighbour)) is not start:
            self._starts[value, neighbour] = start
            self.store(value, self.fit_from(start.point, value))

    def find_best(self) -> tuple[list[float], int]:
        """Return the sorted values, and the index of the likeliest after fits of its neighbours from it."""
        while True:
            values, best = sorted(self.fits), max(self.heights, key=lambda value: self.heights[value])
            k = values.index(best)
            for other in values[max(0, k - 1) : k + 2]:
                self.extend(other, best)
            if self.heights[best] == max(self.heights.values()):
                return values, k

    def choose_values(self) -> tuple[list[float], float]:
        """Fit at further values; return the likeliest value and its neighbours, through which the parabola passes."""
        while True:
            values, k = self.find_best()
            best, beside = values[k], LOOP.profile.beside
            lower, upper = values[0] / LOOP.profile.ratio, values[-1] * LOOP.profile.ratio
            least = self.heights[best] - LOOP.profile.fall
            steep = [value for value in values[max(0, k - 1) : k + 2] if self.heights[value] < least]
            if len(values) >= LOOP.profile.most:
                break
            if k < beside and values[0] not in steep and lower >= self.low:
                self.extend(lower, values[0])
            elif len(values) - 1 - k < beside and values[-1] not in steep and upper <= self.high:
                self.extend(upper, values[-1])
            elif steep:
                self.extend(float(np.sqrt(steep[0] * best)), best)
            else:
                break
        near = values[max(0, k - beside) : k + beside + 1]
        for j, value in enumerate(values):
            if value in near and value != best:  # a better fit may come from the side of the best
                self.extend(value, values[j + 1 if j < k else j - 1])
        return near, best


def _leave_local_minima(rollouts: Rollouts, near: LinearErrors, typical: Array) -> LinearErrors:
    """Refit from multiples of the `multimodal` parameter, over which fits have local minima, while the fit improves."""
    names = [term.get_full_name(find_hints(type(term)).multimodal) for term in near.point.terms]
    while True:
        is_moved = np.isin([*near.point.named_values], names)  # a fit may free another parameter, or bind one
        starts = [
            near.point.with_values(np.where(is_moved, leap, 1.0) * near.point.values) for leap in LOOP.profile.leaps
        ]
        others = [
            fit_rollouts(rollouts, start, typical, nonlinear=True, share=0.0, secants=LOOP.fit.secants[-1:])
            for start in starts
        ]
        best = max(others, key=lambda one: compute_log_likelihood(rollouts, one.error))
        if (
            compute_log_likelihood(rollouts, best.error)
            < compute_log_likelihood(rollouts, near.error) + LOOP.profile.gain
        ):
            return near
        near = best


def _compute_widening(rollouts: Rollouts, near: LinearErrors, place: int) -> float:
    """Return the factor by which errors that are correlated within clusters widen the variance of a parameter."""
    slopes, error = near.weights[:, None] * near.slopes, near.weights * near.error
    correlated = compute_robust_covariance(slopes, error, rollouts.positions.clusters)[place, place]
    size = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)  # units of parameters differ by orders of magnitude
    row = np.linalg.pinv(slopes / size, rcond=1e-6)[place] / size[place] * error
    return float(max(1.0, correlated / max(row @ row, 1e-300)))


def fit_parabola(x: Array, height: Array, widening: float = 1.0) -> tuple[float, float]:
    """Return the vertex of a parabola through maxima of a likelihood, and its variance.

    If the maxima bend upwards or the vertex is beyond them, return the highest, uncertain by half their range.

    Args:
        x: places of the maxima (K,).
        height: the maxima (K,) [nat].
        widening: factor of the variance by the likelihood.
    """
    highest, half = float(x[np.argmax(height)]), 0.5 * float(np.ptp(x))
    if len(x) < 4:  # a parabola through three points shows no scatter
        return highest, half**2
    centre = float(x.mean())
    columns = np.column_stack([-((x - centre) ** 2), x - centre, np.ones_like(x)])
    solution = np.linalg.lstsq(columns, height)[0]
    a, b, _ = solution
    if not (a > 0 and abs(b / (2 * a)) <= half):
        return highest, half**2
    scatter = float(np.sum((height - columns @ solution) ** 2)) / (len(x) - 3)
    covariance = scatter * np.linalg.inv(columns.T @ columns)
    slopes = np.array([-b / (2 * a**2), 1 / (2 * a), 0.0])  # of the vertex, by a and b
    return centre + b / (2 * a), float(slopes @ covariance @ slopes + widening / (2 * a))


def widen_by_profile(names: list[str], covariance: Array, profile: LikelihoodProfile) -> Array:
    """Return the covariance (Q, Q) of named parameters, widened by the variance of a profile.

    Other parameters have their covariance at a known value of the profiled parameter, and change with it by its slopes.
    """
    k = names.index(profile.name)
    row = covariance[k]
    known = covariance - np.outer(row, row) / max(row[k], 1e-300)
    return np.asarray(known + np.outer(profile.slopes, profile.slopes) * profile.variance)
