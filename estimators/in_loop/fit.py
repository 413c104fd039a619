"""Maximum-likelihood fits of whole rollouts by Gauss-Newton.

Errors of a rollout last for seconds. Some are large, because a servo sticks at another position than its model. Their
density is that of a hyperbolic secant, sech(pi e / 2 s) / 2 s: normal in the middle, exponential in its tails. No error
is left out. A large error counts by its absolute value, as in the mean distance that compares servos. One scale s
serves all recordings of a servo. The score of a search uses Student's t, which limits the weight of a single block.

Source: Fischer, Generalized Hyperbolic Secant Distributions, 2014.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from estimators.in_loop.rollouts import Rollouts
from estimators.regression.gauss_newton import LocalErrors, StopRule, gauss_newton
from estimators.search_hints import find_hints
from estimators.weak_form.columns import list_bounds
from estimators.weak_form.nonlinear import list_continuous_parameters, set_values
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Term
from pendulum_env.physics.term import return_zero


@dataclass(frozen=True)
class LoopSettings:
    """Settings of fits in the loop and of searches that use them."""

    iterations: int = 30  # largest number of iterations of a fit
    dampings: tuple[float, ...] = (1e-4, 1e-2, 0.3, 10.0, 300.0)  # of the steps in each iteration
    momenta: tuple[float, ...] = (1.0, 5.0)  # multiples of the last step, each tried with the least damped one
    differences: tuple[float, ...] = (3e-3, 1e-2)  # steps for derivatives, relative to the parameter, in sequence
    secants: tuple[float, ...] = (0.2, 0.06)  # the same over many local minima, to either side
    starts: int = 4  # largest number of starts of a link, at the likeliest values of its profiled parameter
    finalists: int = 2  # number of the best fits from these starts that are fitted to convergence
    shares: tuple[float, ...] = (0.3, 0.6, 0.85)  # shares of the inertia in the starts of a link
    stiffnesses: tuple[float, ...] = (1.0, 2.5)  # factors of its resonance; a fit of torque prefers a soft contact
    damping_ratios: tuple[float, ...] = (0.05, 0.2, 0.5)  # of the contact in the starts of a link
    link_friction: tuple[float, ...] = (0.1, 0.02)  # shares of dry and viscous friction in the starts of a link
    promising: float = 0.05  # share of the squared error that the first start must explain before others are tried
    leap: float = 1.0  # largest step of a parameter, relative to its size
    polls: int = 5  # largest number of polls, which try steps of single parameters
    poll: tuple[float, ...] = (0.1, 0.4)  # lengths of these steps, relative to the parameter
    enough: float = 0.3  # [nat], a fit ends at a smaller gain of an iteration,
    roughly: float = 0.05  # or at this share of its gain so far if models are only compared
    scales: int = 20  # largest number of Newton iterations for an error scale
    settled: float = 1e-7  # relative change of an error scale that has converged
    typical: float = 0.05  # share of the RMS torque at which a parameter matters
    hopeless: float = 15.0  # [nat], gain of the linear fit below which one iteration suffices
    seldom: float = 200.0  # [Hz], assumed rate of a slow controller
    scale: float = 0.1  # relative difference of logged and requested torque that is reported
    faithful: float = 2.0  # error of a model over that of the encoder, below which the reading of the goals is kept
    needed: float = 0.3  # share of the squared error that an effect must explain; sticking alone changes the error
    dominant: float = 0.75  # the same for a link if the residual is not noise: a link imitates another controller


LOOP = LoopSettings()


def compute_error_scales(rollouts: Rollouts, errors: Array) -> Array:
    """Return the scale (...) of errors (R, ...) of models [rad], at least the resolution of the encoder.

    The likeliest scale s solves mean(a tanh(a / s)) = s with a = pi |e| / 2, by Newton's method for the logarithms.
    """
    absolute = np.pi / 2 * np.abs(errors)
    scale = np.maximum(np.mean(absolute, axis=0), rollouts.resolution)
    for _ in range(LOOP.scales):
        relative = absolute / scale
        slope = np.tanh(relative)
        ratio = np.maximum(np.einsum("r...,r...->...", relative, slope) / len(absolute), 1e-300)
        bend = np.einsum("r...,r...,r...->...", relative, relative, 1.0 - slope**2) / len(absolute)
        before, scale = scale, np.maximum(scale * ratio ** (ratio / (ratio + bend)), rollouts.resolution)
        if (np.abs(scale - before) <= LOOP.settled * before).all():
            break
    return np.asarray(scale)


def compute_log_densities(rollouts: Rollouts, errors: Array) -> Array:
    """Return the log density (R, ...) of errors (R, ...) with the scale of each model, without a constant [nat]."""
    scale = compute_error_scales(rollouts, errors)
    relative = np.pi / 2 * np.abs(errors) / scale
    return np.asarray(-np.log(scale) - relative - np.log1p(np.exp(-2 * relative)))


def compute_log_likelihood(rollouts: Rollouts, errors: Array) -> Array:
    """Return the log density (...) of all errors (R, ...) of models, see `compute_log_densities` [nat]."""
    return np.asarray(compute_log_densities(rollouts, errors).sum(axis=0))


def compute_likelihood_scale(rollouts: Rollouts, error: Array) -> float:
    """Return the scale with the same likelihood as the errors (R,) [rad]; a smaller scale is likelier."""
    return float(np.exp(-compute_log_likelihood(rollouts, error) / len(error)))


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
    rollouts: Rollouts, point: Point, typical: Array, nonlinear: bool, length: float | None = None
) -> LinearErrors:
    """Linearise the errors around a point by linear parameters, and by nonlinear parameters if they are free.

    `typical` is the size of each linear parameter that matters (P,). Slopes are those of steps of relative `length`. If
    the likelihood has many local minima, slopes for a nonlinear fit are those of secants to either side.
    """
    has_minima = nonlinear and has_local_minima(point.terms)
    length = length or (LOOP.secants if has_minima else LOOP.differences)[-1]
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
        _bind_terms(point.with_values(np.where(is_changed, value, values)))
        for end in ends
        for is_changed, value in zip(is_moved, end, strict=True)
    ]
    errors = rollouts.without_counts.compute_position_errors([point, *nearby])  # counts have no slopes
    below = errors[:, :1] if len(ends) == 1 else errors[:, count + 1 :]
    slopes = (errors[:, 1 : count + 1] - below) / steps  # zero by known parameters, which `Point.with_values` keeps
    error = errors[:, :1] if rollouts.encoder_step is None else rollouts.compute_position_errors([point])
    scale = compute_error_scales(rollouts, error)[0]
    least = rollouts.encoder_step or 1e-6 * scale  # counts have no smaller error, and steps would be too short
    relative = np.pi / 2 * np.maximum(np.abs(error[:, 0]), least) / scale
    weights = np.pi / 2 / scale * np.sqrt(np.tanh(relative) / relative)
    return LinearErrors(point, error[:, 0], slopes, weights)


def find_bounds(point: Point) -> tuple[Array, Array]:
    """Return the bounds of each free parameter, (P + S,) each."""
    free = [p for term in point.terms for p in list_continuous_parameters(term)]
    lower, upper = list_bounds(point.terms)
    return np.r_[lower, [p.low for p in free]], np.r_[upper, [p.high for p in free]]


def fit_rollouts(
    rollouts: Rollouts,
    point: Point,
    typical: Array,
    nonlinear: bool = False,
    share: float = LOOP.roughly,
    secants: Sequence[float] = LOOP.secants,
) -> LinearErrors:
    """Fit the parameters near a point, and return the errors around the fit.

    Over many local minima, a fit with shorter secants continues from that with longer ones. Otherwise, a fit to
    convergence begins with short steps for derivatives, which lead along a narrow valley; longer ones average over
    steps of the encoder.

    Args:
        rollouts: to fit.
        point: start of the fit.
        typical: size of each linear parameter that matters (P,).
        nonlinear: whether continuous nonlinear parameters are also fitted.
        share: of the gain so far; the fit ends at a smaller gain of an iteration.
        secants: relative lengths of secants over many local minima, in sequence.
    """
    has_minima = nonlinear and has_local_minima(point.terms)
    for length in secants if has_minima else LOOP.differences[-1 if share else 0 :]:
        fit = _fit_by_steps(rollouts, point, typical, nonlinear, share, length)
        point = fit.point
    return fit


def _fit_by_steps(
    rollouts: Rollouts, point: Point, typical: Array, nonlinear: bool, share: float, length: float
) -> LinearErrors:
    """Fit the parameters near a point, with slopes by steps of one length.

    The weights are those of the present errors, so steps are too short along a valley in which all errors decrease:
    steps with a multiple of the last step are also tried. If a step gains too little, up to `LOOP.polls` polls try
    steps of single parameters.
    """
    visited: list[LocalErrors[LinearErrors]] = []
    point = _bind_terms(point)

    def linearise(point: Point) -> LocalErrors[LinearErrors]:
        local = linearise_errors(rollouts, point, typical, nonlinear, length)
        values, (low, high) = point.values, find_bounds(point)
        count, size = local.slopes.shape[1], compute_parameter_sizes(point, typical)
        cost = -float(compute_log_likelihood(rollouts, local.error))
        slopes = local.weights[:, None] * local.slopes * size[:count]
        at_least, at_most = (values <= low)[:count], (values >= high)[:count]
        visited.append(LocalErrors(local, cost, local.weights * local.error, slopes, at_least, at_most))
        return visited[-1]

    polls = iter(range(0 if share or (nonlinear and has_local_minima(point.terms)) else LOOP.polls))

    def choose_step(local: LocalErrors[LinearErrors], steps: list[Array]) -> tuple[Point, float]:
        point, count = local.known.point, local.slopes.shape[1]
        values, size = point.values, compute_parameter_sizes(point, typical)

        def choose_likeliest(steps: list[Array]) -> tuple[Point, float]:
            moves = [np.pad(step, (0, len(values) - count)) * size for step in steps]
            points = [_bind_terms(point.with_values(values + move)) for move in moves]
            best, gain = choose_likeliest_point(rollouts, points)
            return best, -gain

        before = visited[-2].known.point.values if len(visited) > 1 else values
        if len(before) == len(values):  # else a bound parameter became free
            last_step = ((values - before) / size)[:count]
            steps = [*steps, *(steps[0] + momentum * last_step for momentum in LOOP.momenta if last_step.any())]
        best = choose_likeliest([step / max(1.0, float(np.abs(step).max(initial=0.0)) / LOOP.leap) for step in steps])
        is_small = best[1] > local.cost - rule.compute_small_decrease(visited[0].cost, local.cost)
        if is_small and next(polls, None) is not None:
            best = min(best, choose_likeliest(_make_steps(local.slopes)), key=lambda candidate: candidate[1])
        return best

    rule = StopRule(LOOP.iterations, LOOP.dampings, least=LOOP.enough, of_fall=share)
    best_point = gauss_newton(point, linearise, choose_step, rule)
    last = visited[-1].known
    return last if last.point is best_point else linearise_errors(rollouts, best_point, typical, nonlinear, length)


def _bind_terms(point: Point) -> Point:
    """Bind nonlinear parameters of a point to bounds that depend on the linear ones."""
    return point._replace(terms=tuple(term.bind(point.linear_values) for term in point.terms))


def choose_likeliest_point(rollouts: Rollouts, points: Sequence[Point]) -> tuple[Point, float]:
    """Return the likeliest of some points, and its log density without a constant [nat]."""
    likelihoods = compute_log_likelihood(rollouts, rollouts.compute_position_errors(points))
    return points[int(np.argmax(likelihoods))], float(likelihoods.max())


def _make_steps(slopes: Array) -> list[Array]:
    """Return steps (S,) of single parameters and along directions of least information, in sizes of the parameters.

    Their lengths to either side, `LOOP.poll`, reach past a kink of the errors.
    """
    count = slopes.shape[1]
    directions = np.vstack([np.eye(count), np.linalg.eigh(slopes.T @ slopes)[1].T[: count // 2]])
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    return [sign * share * direction for direction in directions for share in LOOP.poll for sign in (1, -1)]


def list_link_starts(point: Point, variants: Sequence[Term]) -> list[Point]:
    """Return starts of a fit of a model with a link, from variants of the link; its weight is that of the joint.

    `point` is the fit without a link. Variants that differ by weight or damping alone have the same starts.
    """
    inertia, weight = point.linear_values.get("inertia", 0.0), abs(point.linear_values.get("gravity", 0.0))
    points: dict[tuple[Term, float], Point] = {}
    for variant, factor, share, ratio in product(variants, LOOP.stiffnesses, LOOP.shares, LOOP.damping_ratios):
        resonance = factor * variant.nonlinear_values["resonance"]
        link_values = {
            "resonance": resonance,
            "damping": 2.0 * ratio * resonance,
            "gravity": weight / max(share * inertia, 1e-9),
        }
        parameters = [p for p in variant.nonlinear_parameters if p.name in link_values]
        term = set_values(variant, parameters, [link_values[p.name] for p in parameters])
        points[term, share] = Point.from_parameters((*point.terms, term), np.append(point.theta, share * inertia))
    return [*points.values()]
