"""Output error: parameters refined by simulated motion over many short segments.

Simulation includes the information in and around stick, which equations clear of stick lack. All segments and all
perturbed parameters are simulated as one batch, and the parameters are fitted to the measured positions (Gauss-Newton).
The initial state of each segment is free: its two sensitivities are projected out. Long segments start from the
measured state, because a free state hides a drift.

With filters, errors are innovations. If the residual is noise, the fit is then of maximum likelihood.

Source: Ljung, System Identification, 2nd edition, section 10.2, with multiple shooting as in Bock 1983.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.gauss_newton import LocalErrors, StopRule, choose_least, gauss_newton
from estimators.regression.least_squares import compute_robust_covariance
from estimators.simulation.free_running import Segments, simulate_all
from estimators.simulation.innovations import Innovations
from estimators.weak_form.columns import mark_bounds
from estimators.weak_form.nonlinear import list_nonlinear_names
from estimators.weak_form.point import Point
from estimators.weak_form.window_noise import compute_jump_errors
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model

DRAWS = 16  # number of noise draws; ratios to a mean of fewer draws are biased
OUTPUT_ERROR_SHARES = (1.0, 0.5, 0.2, 0.05)  # tried shares of the least damped step
OUTPUT_ERROR_DAMPINGS = (1e-6, 1e-3, 0.1, 3.0)  # of Gauss-Newton steps; the larger ones only if the start stays
OUTPUT_ERROR_ITERATIONS = 12  # largest number of Gauss-Newton steps
OUTPUT_ERROR_DIFFERENCE = 1e-4  # relative change of a parameter for derivatives; larger ones cross events of stick
MAX_STEP_FROM_ZERO = 0.5  # largest step of a parameter from zero, in the unit of the parameter
MIN_SIZE = 1e-3  # least size to which changes of a parameter are relative, in the unit of the parameter
GRAIN = 0.004  # [s] between the positions that are compared
PERTURBATION = np.array([1e-4, 1e-3])  # of the initial position [rad] and velocity [rad/s], for their sensitivities
Filters = Sequence[Innovations]  # one per recording; empty for unfiltered errors


def compute_errors(
    segments: Sequence[Segments], points: Sequence[Point], filters: Filters = (), from_measured: bool = False
) -> tuple[Array, Index]:
    """Return position errors of V points (M, V) of all segments in a row, and the segment of each row (M,).

    The part of each segment's error in the span of its two initial-state sensitivities is projected out, unless the
    motion starts `from_measured` states. Filters turn the errors [rad] into innovations, in standard deviations.
    """
    models = [*points, points[0], points[0]]
    perturbations = np.zeros((len(models), 2))
    perturbations[-2:] = np.diag(PERTURBATION)
    paths = simulate_all(segments, models, perturbations)
    filters_or_none: Sequence[Innovations | None] = filters or [None] * len(paths)
    # (B, N, V) each
    parts = [_compute_errors(*parts, from_measured) for parts in zip(segments, paths, filters_or_none, strict=True)]
    counts = np.concatenate([np.full(len(part), part.shape[1]) for part in parts])
    return np.concatenate([part.reshape(-1, len(points)) for part in parts]), np.repeat(np.arange(len(counts)), counts)


def _compute_errors(segments: Segments, path: Array, filter: Innovations | None, from_measured: bool) -> Array:
    """Return errors (B, N, V) of positions (N + 1, V + 2, B), the last two from perturbed initial states."""
    grain = choose_grain(segments)
    path, measured = path[grain::grain], segments.position[grain::grain]
    sensitivity = np.moveaxis((path[:, -2:] - path[:, :1]) / PERTURBATION[:, None], 2, 0)  # (B, N, 2)
    error = np.moveaxis(path[:, :-2] - measured[:, None], 2, 0)  # (B, N, V)
    if filter is not None:
        sensitivity, error = np.split(filter.whiten(np.concatenate([sensitivity, error], axis=2)), [2], axis=2)
    if from_measured:
        return np.asarray(error)
    frames, _ = np.linalg.qr(sensitivity)
    return np.asarray(error - frames @ (np.swapaxes(frames, 1, 2) @ error))


def choose_grain(segments: Segments) -> int:
    """Return the number of samples from one compared position to the next, at least 1."""
    return max(1, round(GRAIN * segments.windows.recording.rate))


def make_innovations(segments: Sequence[Segments], point: Point) -> list[Innovations]:
    """Make the filters of the errors around a point."""
    return [Innovations.from_segments(segment, *point, choose_grain(segment)) for segment in segments]


def compute_segment_rms(segments: Sequence[Segments], point: Point, filters: Filters = ()) -> Array:
    """Return the RMS error of each segment of all recordings [rad]."""
    return compute_rms_by_segment(*compute_errors(segments, [point], filters))


def compute_rms_by_segment(error: Array, segment: Index) -> Array:
    """Return the RMS of the errors (M, 1) of each segment, plus 1e-12; `segment` is the segment of each error (M,)."""
    return np.asarray(np.sqrt(np.bincount(segment, error[:, 0] ** 2) / np.bincount(segment)) + 1e-12)


def weigh_segments(sizes: Array) -> Array:
    """Return weights of segments (B,) from their RMS errors: 1 / (1 + (error / 3 medians)^2)."""
    return np.asarray(1 / (1 + (sizes / (3 * float(np.median(sizes)))) ** 2))


ErrorsOf = Callable[[Sequence[Point]], Array]  # weighted errors (M, V) of V points


def compute_slopes(errors_of: ErrorsOf, point: Point) -> tuple[Array, Array]:
    """Return errors (M,) at a point, and their slopes by relative changes of the parameters (M, P + S)."""
    values = point.values
    size = np.maximum(np.abs(values), MIN_SIZE)
    nearby = [
        point.with_values(values + OUTPUT_ERROR_DIFFERENCE * size * direction) for direction in np.eye(len(values))
    ]
    error = errors_of([point, *nearby])
    return error[:, 0], (error[:, 1:] - error[:, :1]) / OUTPUT_ERROR_DIFFERENCE


def _weigh_errors(segments: Sequence[Segments], point: Point, filters: Filters) -> ErrorsOf:
    """Make the function from points to the errors of the segments with free initial states.

    Errors are weighted by the segment's error at `point`, see `weigh_segments`.
    """
    weights = np.sqrt(weigh_segments(compute_segment_rms(segments, point, filters)))

    def errors_of(points: Sequence[Point]) -> Array:
        error, segment = compute_errors(segments, points, filters)
        return np.asarray(error * weights[segment, None])

    return errors_of


def fit_segments(segments: Sequence[Segments], start: Point, filters: Filters = ()) -> Point:
    """Fit the linear and the continuous nonlinear parameters to the segments, with free initial states."""
    return minimise(_weigh_errors(segments, start, filters), start)


def minimise(errors_of: ErrorsOf, start: Point) -> Point:
    """Minimise the sum of squared errors by Gauss-Newton from a point.

    If no step from there lowers it, larger dampings follow: between nearly collinear parameters, steps are too long.
    """

    def linearise(point: Point) -> LocalErrors[Point]:
        error, slopes = compute_slopes(errors_of, point)
        return LocalErrors(point, float(error @ error), error, slopes)

    has_damped_steps = False

    def choose_step(local: LocalErrors[Point], steps: list[Array]) -> tuple[Point, float]:
        nonlocal has_damped_steps
        values, smallest = local.known.values, MIN_SIZE
        size = np.maximum(np.abs(values), smallest)
        # a parameter of zero needs an absolute step
        longest = np.where(size > smallest, 0.5, MAX_STEP_FROM_ZERO / smallest)
        first, *damped = (np.clip(step, -longest, longest) * size for step in steps)

        def choose_move(moves: list[Array]) -> tuple[Point, float]:
            points = [local.known.with_values(values + move) for move in moves]
            return choose_least(points, np.sum(errors_of(points) ** 2, axis=0))

        chosen = choose_move([share * first for share in OUTPUT_ERROR_SHARES] + (damped if has_damped_steps else []))
        if chosen[1] < local.cost or local.known is not start:
            return chosen
        has_damped_steps = True
        return choose_move(damped)

    rule = StopRule(OUTPUT_ERROR_ITERATIONS, OUTPUT_ERROR_DAMPINGS, by_offset=True)
    return gauss_newton(start, linearise, choose_step, rule)


def fit_maximum_likelihood(segments: Sequence[Segments], start: Point) -> Model:
    """Fit a model near a point by innovations, of maximum likelihood if the residual is noise.

    Segments should be about half a second long: errors of longer segments grow nonlinearly.
    """
    filters = make_innovations(segments, start)
    return make_model(segments, fit_segments(segments, start, filters=filters), filters)


def compute_rms(segments: Sequence[Segments], point: Point, filters: Filters = ()) -> float:
    """Return the RMS error of the segments with free initial states [rad]; with filters, of the innovations."""
    error, _ = compute_errors(segments, [point], filters)
    return float(np.sqrt(np.mean(error**2)))


def compute_noise(segments: Sequence[Segments], point: Point, has_free_states: bool = False) -> Array:
    """Return the mean square change of the positions of each segment by noise of torque and initial velocity (B,).

    With free initial states, the velocity has no noise, and the part that the states explain is left out. Segments
    differ: torque that was moved in time is uncertain at its jumps, and an unstable motion amplifies noise.
    """
    rng, perturbed = np.random.default_rng(0), list[Segments]()
    for segment, path in [*zip(segments, simulate_all(segments, [point]), strict=True)] * DRAWS:
        noisy = replace(segment, torque=redraw_torque(segment, rng), position=path[:, 0])
        if not has_free_states:
            change = segment.windows.noise.velocity * rng.standard_normal(segment.velocity.shape)
            noisy = replace(noisy, velocity=segment.velocity + change)
        perturbed.append(noisy)
    if has_free_states:
        squares = compute_segment_rms(perturbed, point) ** 2
    else:
        pairs = zip(simulate_all(perturbed, [point]), perturbed, strict=True)
        squares = np.concatenate([np.mean((path[:, 0] - noisy.position)[1:] ** 2, axis=0) for path, noisy in pairs])
    return np.asarray(np.mean(squares.reshape(DRAWS, -1), axis=0))


def compute_uncertainty(segments: Sequence[Segments], model: Model) -> Array:
    """Return the mean square change of the positions of each segment by errors of the parameters, to first order (B,).

    Initial states are free. Parameters with an infinite error count as known.
    """
    point, names = Point.from_model(model), [*model.estimates]
    place = [names.index(name) for name in (*(c.name for c in model.columns), *list_nonlinear_names(point.terms))]
    size = np.maximum(np.abs(point.values), MIN_SIZE)
    covariance = model.assumed_covariance[np.ix_(place, place)] / size[:, None] / size
    covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    _, slopes = compute_slopes(lambda points: compute_errors(segments, points)[0], point)
    _, segment = compute_errors(segments, [point])
    squares = np.maximum(np.einsum("mp,pq,mq->m", slopes, covariance, slopes), 0.0)
    return np.asarray(np.bincount(segment, squares) / np.bincount(segment))


def redraw_torque(segment: Segments, rng: np.random.Generator) -> Array:
    """Add white noise and the errors of jumps to the held torque (N, B) [N m]."""
    index = segment.first + np.arange(len(segment.torque))[:, None]
    std = np.hypot(segment.windows.noise.raw_torque, compute_jump_errors(segment.windows.recording)[index])
    return np.asarray(segment.torque + std * rng.standard_normal(segment.torque.shape))


def make_model(segments: Sequence[Segments], point: Point, filters: Filters = ()) -> Model:
    """Return the model at a point, with standard errors from the spread of the segments (jackknife's sandwich)."""
    error, slopes = compute_slopes(_weigh_errors(segments, point, filters), point)
    _, segment = compute_errors(segments, [point], filters)
    return make_model_with_covariance(point, compute_robust_covariance(slopes, error, segment))


def make_model_with_covariance(point: Point, relative: Array) -> Model:
    """Make the model at a point, with the covariance (P + S, P + S) `relative` to the size of the parameters."""
    std = np.sqrt(np.diag(relative)) * np.maximum(np.abs(point.values), MIN_SIZE)
    names, count = list_nonlinear_names(point.terms), len(point.theta)
    model = Model.build(*point, std[:count], **dict(zip(names, std[count:].tolist(), strict=True)))
    return mark_bounds(model).with_covariance([*(column.name for column in model.columns), *names], relative)
