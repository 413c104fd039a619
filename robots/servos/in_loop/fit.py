"""Maximum-likelihood fits of whole rollouts by Gauss-Newton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.regression.gauss_newton import LocalErrors, StopRule, gauss_newton
from estimators.weak_form.point import Point
from pendulum_env._typing import Array
from robots.servos.in_loop.likelihood import choose_likeliest_point, compute_log_likelihood
from robots.servos.in_loop.linearisation import (
    LinearErrors,
    bind_terms,
    compute_parameter_sizes,
    find_bounds,
    has_local_minima,
    linearise_errors,
)
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.settings import LOOP


def fit_rollouts(
    rollouts: Rollouts,
    point: Point,
    typical: Array,
    nonlinear: bool = False,
    share: float = LOOP.fit.roughly,
    secants: Sequence[float] = LOOP.fit.secants,
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
    for length in secants if has_minima else LOOP.fit.differences[-1 if share else 0 :]:
        fit = _fit_by_steps(rollouts, point, typical, nonlinear, share, length)
        point = fit.point
    return fit


def _fit_by_steps(
    rollouts: Rollouts, point: Point, typical: Array, nonlinear: bool, share: float, length: float
) -> LinearErrors:
    """Fit the parameters near a point, with slopes by steps of one length.

    The weights are those of the present errors, so steps are too short along a valley in which all errors decrease:
    steps with a multiple of the last step are also tried. If a step gains too little, up to `LOOP.fit.polls` polls try
    steps of single parameters.
    """
    visited: list[LocalErrors[LinearErrors]] = []
    simulated: list[tuple[Point, Array]] = []  # last chosen points with their errors
    point = bind_terms(point)

    def find_errors(point: Point) -> LinearErrors:
        error = next((error for other, error in simulated if other is point), None)
        return linearise_errors(rollouts, point, typical, nonlinear, length, error)

    def linearise(point: Point) -> LocalErrors[LinearErrors]:
        local = find_errors(point)
        values, (low, high) = point.values, find_bounds(point)
        count, size = local.slopes.shape[1], compute_parameter_sizes(point, typical)
        cost = -float(compute_log_likelihood(rollouts, local.error))
        slopes = local.weights[:, None] * local.slopes * size[:count]
        at_least, at_most = (values <= low)[:count], (values >= high)[:count]
        visited.append(LocalErrors(local, cost, local.weights * local.error, slopes, at_least, at_most))
        return visited[-1]

    is_long = len(rollouts.positions.measured) > LOOP.fit.long_count  # the start is a fit of pieces
    polls = iter(range(0 if share or is_long or (nonlinear and has_local_minima(point.terms)) else LOOP.fit.polls))

    def choose_step(local: LocalErrors[LinearErrors], steps: list[Array]) -> tuple[Point, float]:
        point, count = local.known.point, local.slopes.shape[1]
        values, size = point.values, compute_parameter_sizes(point, typical)

        def choose_likeliest(steps: list[Array]) -> tuple[Point, float]:
            moves = [np.pad(step, (0, len(values) - count)) * size for step in steps]
            points = [bind_terms(point.with_values(values + move)) for move in moves]
            best, gain, error = choose_likeliest_point(rollouts, points)
            simulated[:] = [*simulated[-1:], (best, error)]  # one of them is the next point
            return best, -gain

        before = visited[-2].known.point.values if len(visited) > 1 else values
        if len(before) == len(values):  # else a bound parameter became free
            last_step = ((values - before) / size)[:count]
            steps = [*steps, *(steps[0] + momentum * last_step for momentum in LOOP.fit.momenta if last_step.any())]
        best = choose_likeliest(
            [step / max(1.0, float(np.abs(step).max(initial=0.0)) / LOOP.fit.leap) for step in steps]
        )
        is_small = best[1] > local.cost - rule.compute_small_decrease(visited[0].cost, local.cost)
        if is_small and next(polls, None) is not None:
            best = min(best, choose_likeliest(_make_steps(local.slopes)), key=lambda candidate: candidate[1])
        return best

    rule = StopRule(LOOP.fit.iterations, LOOP.fit.dampings, least=LOOP.fit.enough, of_fall=share)
    best_point = gauss_newton(point, linearise, choose_step, rule)
    last = visited[-1].known
    return last if last.point is best_point else find_errors(best_point)


def _make_steps(slopes: Array) -> list[Array]:
    """Return steps (S,) of single parameters and along directions of least information, in sizes of the parameters.

    Their lengths to either side, `LOOP.fit.poll`, reach past a kink of the errors.
    """
    count = slopes.shape[1]
    directions = np.vstack([np.eye(count), np.linalg.eigh(slopes.T @ slopes)[1].T[: count // 2]])
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    return [sign * share * direction for direction in directions for share in LOOP.fit.poll for sign in (1, -1)]
