"""Multiple shooting: short segments with fitted initial states, for transmissions with an unmeasured link.

Each bounce amplifies the error of a link's simulated state, which is lost after a few bounces. In segments of a
quarter of a second errors stay bounded. Initial states are fitted by Levenberg-Marquardt with a damping per segment,
from both sides of the play. Parameters are fitted together with the states by Gauss-Newton.

Source: Bock, Randwertproblemmethoden zur Parameteridentifizierung, 1987; for the elimination of the states, Golub and
Pereyra, Inverse Problems 19(2), 2003.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.gauss_newton import LocalErrors, StopRule, choose_least, gauss_newton
from estimators.regression.least_squares import compute_robust_covariance
from estimators.search_hints import find_hints
from estimators.simulation.free_running import (
    Segments,
    count_periods,
    cut_segments,
    list_spans,
    select_segments,
    simulate_segments,
    start_memory,
)
from estimators.simulation.output_error import MIN_SIZE, choose_grain, make_model_with_covariance, weigh_segments
from estimators.weak_form.nonlinear import set_values
from estimators.weak_form.point import Point
from estimators.weak_form.traces import trace_all
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.physics import Model, Samples, Term, Trajectory, find_link
from pendulum_env.physics.term import Memory

# position and velocity of motor and link [rad], [rad/s]: steps for derivatives
PERTURBATION = np.array([3e-4, 3e-3, 1e-3, 1e-2])
SMOOTH_FACTOR = 0.03  # factor on these steps without contacts: errors of derivatives by states bias the parameters
DAMPING = np.array([0.01, 1.0, 100.0])  # tried factors on the damping of a segment's state
LENGTH = 0.25  # length of a segment [s]
COARSE_STEP = 1e-3  # step of the integrator [s]
FINE_STEP = 0.25e-3  # step of the integrator in the last fit [s]; a step h shifts a resonance w by (w h)^2 / 24
INITIAL_ITERATIONS = 2  # iterations of each start of a segment's state
MORE_ITERATIONS = 4  # additional iterations of segments with large errors
LARGE_ERROR = 2.0  # least large error [median errors]
FINAL_ITERATIONS = 6  # largest number of iterations of the best start
MIN_SEGMENTS = 2  # least number of segments per parameter
MAX_SEGMENTS = 120  # approximate largest number of segments in a fit of parameters
SHOOTING_DIFFERENCE = 1e-2  # relative change of a parameter for derivatives
SHOOTING_SHARES = (1.0, 0.4, 0.1, 0.0)  # tried shares of a step of the parameters
MAX_CHANGE = 0.3  # largest relative change of a parameter in a step
SHOOTING_DAMPING = 1e-4  # damping of a step of the parameters
MAX_ITERATIONS = 25  # largest number of iterations
TRIAL_ITERATIONS = 6  # largest number of iterations of each compared start
STIFFNESS_FACTORS = (1.0, 1.8)  # factors on the contact's stiffness at the starts of a fit
MAX_CLIMBS = 4  # largest number of trials of a stiffer and wider play
CLIMB_RATIO = 0.9  # largest ratio of errors after and before a trial
MIN_GAIN = 0.01  # least relative decrease of the squared error in an iteration
PATIENCE = 2  # number of iterations with a smaller decrease after which a fit ends


@dataclass(frozen=True)
class Shooting:
    """Segments of one recording with their initial states.

    Attributes:
        segments: B segments.
        states: position, velocity, and hidden states of the link at the start (S, B).
        damping: damping of the state of each segment (B,).
        step: longest step of the integrator [s].
    """

    segments: Segments
    states: Array
    damping: Array
    step: float = COARSE_STEP

    def simulate(
        self, points: Sequence[Point], states: Array, observe: Callable[[Samples], None] | None = None
    ) -> Trajectory:
        """Simulate segments of V points from states (V, S, B); `observe` as in `simulate`.

        Returns:
            Trajectory with series (N + 1, V B).
        """
        q, v, *hidden = (row.ravel() for row in np.swapaxes(states, 0, 1))
        link = {find_link(points[0].terms).id: tuple(hidden)}
        return simulate_segments([self.segments], points, q, v, link, self.step, observe)

    def errors(self, points: Sequence[Point], states: Array) -> Array:
        """Return position errors (V, F, B, N) [rad] of V points, from F sets of states each (V, F, S, B)."""
        grain, (count, times, *shape) = choose_grain(self.segments), states.shape
        repeated = [point for point in points for _ in range(times)]
        path = self.simulate(repeated, states.reshape(-1, *shape)).position[grain::grain]
        measured = self.segments.position[grain::grain, None, None]
        return np.moveaxis(path.reshape(len(path), count, times, -1) - measured, 0, 3)

    def choose_states(self, points: Sequence[Point], states: Array) -> tuple[Array, Array, Index]:
        """Choose the best of F sets of states for each of V points and each segment (V, F, S, B).

        Returns:
            States (V, S, B), their squared errors (V, B), and the number of the chosen set (V, B).
        """
        squares = np.sum(self.errors(points, states) ** 2, axis=3)
        best = np.argmin(squares, axis=1)[:, None]  # (V, 1, B)
        chosen = np.take_along_axis(states, best[:, :, None], 1)[:, 0]
        return chosen, np.take_along_axis(squares, best, 1)[:, 0], best[:, 0]


def start_shooting(windows: Windows, point: Point, first: Index) -> Shooting:
    """Cut segments that start at given samples, with initial states from the measured motion."""
    segments, link = cut_segments(windows, first, count_periods(windows, LENGTH)), find_link(point.terms)
    hidden = start_memory([segments], [link])[link.id]
    states = np.array([segments.position[0], segments.velocity, *hidden])
    return Shooting(segments, states, np.full(len(first), DAMPING[0]))


def list_adjacent_segments(windows: Windows) -> Index:
    """Return the first samples of adjacent segments along a part of a recording."""
    length = count_periods(windows, LENGTH)
    ends = [(begin, end - length - 1) for begin, end in list_spans(windows)]
    return np.concatenate([np.unique(np.append(np.arange(b, last, length), last)) for b, last in ends if last >= b])


def compute_state_slopes(shooting: Shooting, points: Sequence[Point], states: Array) -> tuple[Array, Array]:
    """Return errors (V, B, N) of V points from V sets of states (V, S, B), and slopes by states (V, B, N, S)."""
    moves = PERTURBATION * (1.0 if find_hints(type(find_link(points[0].terms))).multimodal else SMOOTH_FACTOR)
    perturbations = np.vstack([np.zeros(len(moves)), np.diag(moves)])[None, :, :, None]
    errors = shooting.errors(points, states[:, None] + perturbations)
    return errors[:, 0], np.moveaxis((errors[:, 1:] - errors[:, :1]) / moves[:, None, None], 1, 3)


def compute_state_steps(error: Array, slopes: Array, damping: Array) -> Array:
    """Return Levenberg-Marquardt steps of states (F, S, B) for the F factors `DAMPING` on the damping (B,).

    `error` is (B, N) [rad], and `slopes` are its derivatives by the states (B, N, S).
    """
    information = np.swapaxes(slopes, 1, 2) @ slopes
    diagonal = np.einsum("bss->bs", information)[:, :, None] * np.eye(slopes.shape[2])
    gradient = np.einsum("bns,bn->bs", slopes, error)[:, :, None]
    damped = [information + (d * damping)[:, None, None] * diagonal + 1e-16 * np.eye(len(diagonal[0])) for d in DAMPING]
    return np.array([-np.linalg.solve(matrix, gradient)[:, :, 0].T for matrix in damped])


def refine_states(
    shooting: Shooting, points: Sequence[Point], states: Array, damping: Array, iterations: int
) -> tuple[Array, Array, Array]:
    """Fit states (V, S, B) at each of V points; return states, damping (V, B) and squared errors (V, B)."""
    for _ in range(iterations):
        error, slopes = compute_state_slopes(shooting, points, states)
        before = np.sum(error**2, axis=2)
        candidates = np.array(
            [s + compute_state_steps(*arguments) for s, *arguments in zip(states, error, slopes, damping, strict=True)]
        )  # (V, F, S, B)
        tried, after, best = shooting.choose_states(points, candidates)
        is_better, new_damping = after < before, np.clip(damping * DAMPING[best], 1e-6, 1e3)
        states, squares = np.where(is_better[:, None], tried, states), np.minimum(after, before)
        damping = np.where(is_better, new_damping, np.minimum(30 * damping, 1e3))
    return states, damping, squares


def initialise_states(shooting: Shooting, point: Point) -> tuple[Shooting, Array]:
    """Return the segments with the best initial states for a point, and their squared errors (B,).

    The starts are the present states, the states from the measured motion, and a link on either side of the play.
    """
    traced = start_shooting(shooting.segments.windows, point, shooting.segments.first).states
    gap = find_link(point.terms).nonlinear_values.get("gap", 0.0)
    candidates = [shooting.states, traced]
    for side in (-1, 0, 1) if gap else ():
        candidates.append(np.array([traced[0], traced[1], traced[0] + side * gap, traced[1]]))
    start, points = np.full((len(candidates), traced.shape[1]), DAMPING[0]), [point] * len(candidates)
    fits = refine_states(shooting, points, np.array(candidates), start, INITIAL_ITERATIONS)
    size = np.sqrt(fits[2].min(axis=0))
    far_segments = np.flatnonzero(size > LARGE_ERROR * np.median(size))
    if len(far_segments):
        _refine_some(shooting, points, fits, far_segments, MORE_ITERATIONS)
    best, segment = np.argmin(fits[2], axis=0), np.arange(len(size))
    fits = fits[0][best, :, segment].T[None], fits[1][None, best, segment], fits[2][None, best, segment]
    n_slow = np.zeros(len(segment), dtype=int)
    for _ in range(FINAL_ITERATIONS):
        active = np.flatnonzero(n_slow < PATIENCE)
        if not len(active):
            break
        before = fits[2][0, active]
        _refine_some(shooting, [point], fits, active, 1)
        n_slow[active] += fits[2][0, active] > before * (1 - MIN_GAIN)
    return replace(shooting, states=fits[0][0], damping=start[0]), fits[2][0]


def _refine_some(
    shooting: Shooting, points: Sequence[Point], fits: tuple[Array, Array, Array], numbers: Index, iterations: int
) -> None:
    """Refine states, damping and squared errors of some segments in place."""
    part = replace(shooting, segments=select_segments(shooting.segments, numbers))
    states, damping, squares = fits
    states[:, :, numbers], damping[:, numbers], squares[:, numbers] = refine_states(
        part, points, states[:, :, numbers], damping[:, numbers], iterations
    )


def simulate_link_motion(windows: Windows, model: Model) -> Samples:
    """Simulate the motion of motor and link in adjacent segments, and return the samples of the recording."""
    point, term = Point.from_model(model), find_link(model.terms)
    x = trace_all([windows], [term])[0][0]
    shooting, _ = initialise_states(start_shooting(windows, point, list_adjacent_segments(windows)), point)
    memories: list[Memory] = []
    path = shooting.simulate([point], shooting.states[None], lambda state: memories.append(state.memory[term.id]))
    index = shooting.segments.first + np.arange(len(path.position))[:, None]

    def fill_segments(measured: ArrayLike, simulated: Array) -> Array:
        series = np.array(measured, dtype=float)
        series[index] = simulated
        return series

    link_series = (np.array(series) for series in zip(*memories, strict=True))
    link = tuple(fill_segments(old, new) for old, new in zip(x.memory[term.id], link_series, strict=True))
    q, v = fill_segments(x.position, path.position), fill_segments(x.velocity, path.velocity)
    return replace(x, position=q, velocity=v, memory={term.id: link})


def estimate_link_state(segments: Segments, x: Samples, term: Term) -> Memory:
    """Return the state of a link at the start of segments, at its estimated offset from the motor."""
    position, velocity = (series[segments.first] for series in x.memory[term.id])
    q, v = np.asarray(x.position)[segments.first], np.asarray(x.velocity)[segments.first]
    return segments.position[0] + position - q, segments.velocity + velocity - v


@dataclass(frozen=True)
class Slopes:
    """Errors of all segments in a row, and their derivatives by relative changes of the parameters.

    Attributes:
        error: weighted errors (M,) without the part that initial states explain; divergent segments have low weights.
        by_parameter: derivatives of `error` (M, P).
        segment: number of the segment of each row (M,).
        weights: weights of the segments of each recording (B,).
        parts: for each recording errors (B, N), derivatives by the parameters (B, N, P) and by the states (B, N, S).
    """

    error: Array
    by_parameter: Array
    segment: Index
    weights: tuple[Array, ...]
    parts: tuple[tuple[Array, Array, Array], ...]


def _linearise(shootings: Sequence[Shooting], point: Point) -> Slopes:
    """Linearise the errors of all segments around a point and their present states."""
    values = point.values
    size = np.maximum(np.abs(values), MIN_SIZE)
    nearby = [point.with_values(values + SHOOTING_DIFFERENCE * size * direction) for direction in np.eye(len(values))]
    parts = []
    for shooting in shootings:
        (error,), (by_state,) = compute_state_slopes(shooting, [point], shooting.states[None])
        nearby_errors = shooting.errors(nearby, np.repeat(shooting.states[None, None], len(nearby), axis=0))[:, 0]
        parts.append((error, np.moveaxis((nearby_errors - error) / SHOOTING_DIFFERENCE, 0, 2), by_state))
    free = [_remove_states(*move) for move in parts]
    size = np.concatenate([np.sqrt(np.mean(error**2, axis=1)) for error, _, _ in parts]) + 1e-12
    weights = tuple(np.split(weigh_segments(size), np.cumsum([len(error) for error, _, _ in parts])[:-1]))
    root = [np.sqrt(w) for w in weights]
    counts = np.concatenate([np.full(len(error), error.shape[1]) for error, _, _ in parts])
    return Slopes(
        np.concatenate([(r[:, None] * error).ravel() for r, (error, _) in zip(root, free, strict=True)]),
        np.concatenate([(r[:, None, None] * s).reshape(-1, len(values)) for r, (_, s) in zip(root, free, strict=True)]),
        np.repeat(np.arange(len(counts)), counts),
        weights,
        tuple(parts),
    )


def _remove_states(error: Array, by_parameter: Array, by_state: Array) -> tuple[Array, Array]:
    """Project the span of the derivatives by the states (B, N, S) out of errors (B, N) and slopes (B, N, P)."""
    frames, _ = np.linalg.qr(by_state / (np.linalg.norm(by_state, axis=1, keepdims=True) + 1e-300))
    columns = np.concatenate([error[:, :, None], by_parameter], axis=2)
    columns = columns - frames @ (np.swapaxes(frames, 1, 2) @ columns)
    return columns[:, :, 0], columns[:, :, 1:]


@dataclass(frozen=True)
class FittedShooting:
    """Parameters, segments of all recordings with fitted states, and their squared error."""

    point: Point
    shootings: tuple[Shooting, ...]
    cost: float = np.inf


def fit_shooting(shootings: Sequence[Shooting], point: Point, iterations: int = MAX_ITERATIONS) -> FittedShooting:
    """Fit parameters and states to the segments of all recordings."""

    def linearise(place: FittedShooting) -> LocalErrors[tuple[FittedShooting, Slopes]]:
        slopes = _linearise(place.shootings, place.point)
        pairs = zip(slopes.weights, slopes.parts, strict=True)
        cost = sum(float(w @ np.sum(error**2, axis=1)) for w, (error, *_) in pairs)
        return LocalErrors((place, slopes), cost, slopes.error, slopes.by_parameter)

    def choose_step(
        local: LocalErrors[tuple[FittedShooting, Slopes]], steps: list[Array]
    ) -> tuple[FittedShooting, float]:
        place, slopes = local.known
        values, step = place.point.values, np.clip(steps[0], -MAX_CHANGE, MAX_CHANGE)
        size = np.maximum(np.abs(values), MIN_SIZE)
        points = [place.point.with_values(values + share * step * size) for share in SHOOTING_SHARES]
        pairs = zip(place.shootings, slopes.parts, strict=True)
        trials = [_try_steps(shooting, points, step, move) for shooting, move in pairs]
        costs = np.sum([w @ squares.T for (_, _, squares), w in zip(trials, slopes.weights, strict=True)], axis=0)
        k, _ = choose_least(range(len(points)), costs)
        chosen = [(states[k : k + 1], damping[k : k + 1]) for states, damping, _ in trials]
        tried = zip(place.shootings, chosen, strict=True)
        refined = [refine_states(shooting, points[k : k + 1], *start, 1) for shooting, start in tried]
        cost = sum(float(w @ squares[0]) for w, (_, _, squares) in zip(slopes.weights, refined, strict=True))
        known = zip(place.shootings, refined, strict=True)
        shootings = [replace(shooting, states=states[0], damping=damped[0]) for shooting, (states, damped, _) in known]
        if cost > local.cost * (1 - MIN_GAIN):
            restarted = [initialise_states(shooting, points[k]) for shooting in shootings]
            shootings = [shooting for shooting, _ in restarted]
            cost = sum(float(w @ squares) for w, (_, squares) in zip(slopes.weights, restarted, strict=True))
        return FittedShooting(points[k], tuple(shootings), cost), cost

    rule = StopRule(iterations, (SHOOTING_DAMPING,), of_cost=MIN_GAIN, patience=PATIENCE)
    return gauss_newton(FittedShooting(point, tuple(shootings)), linearise, choose_step, rule)


def _try_steps(
    shooting: Shooting, points: Sequence[Point], step: Array, move: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Return states, their damping and squared errors (V, B) after each share of a step of the parameters."""
    error, by_parameter, by_state = move
    expected = [error + share * (by_parameter @ step) for share in SHOOTING_SHARES]
    unchanged = np.repeat(shooting.states[None], len(points), axis=0)
    steps = np.array([compute_state_steps(errors, by_state, shooting.damping) for errors in expected])
    candidates = np.concatenate([shooting.states + steps, unchanged[:, None]], axis=1)
    states, squares, best = shooting.choose_states(points, candidates)
    return states, np.clip(shooting.damping * np.append(DAMPING, DAMPING[-1])[best], 1e-6, 1e3), squares


def estimate(windows: Sequence[Windows], model: Model) -> Model:
    """Fit a model by multiple shooting, with standard errors from the spread of the segments.

    Args:
        windows: windows of each recording.
        model: start of the fit; one of its terms has a link. It is returned unchanged if segments are too few.
    """
    point, multimodal = Point.from_model(model), find_hints(type(find_link(model.terms))).multimodal
    if _lacks_segments(windows, point):
        return model
    if multimodal:  # a loose contact has local minima at several stiffnesses; `model` may be at a soft contact

        def fit_best(starts: Sequence[Point]) -> FittedShooting:
            fits = (fit_shooting(prepare_segments(windows, p, 3), p, TRIAL_ITERATIONS) for p in starts)
            return min(fits, key=lambda fitted: fitted.cost)

        starts = [change_point(p, {multimodal: f}) for p in (point, add_link_gravity(point)) for f in STIFFNESS_FACTORS]
        best = fit_best(starts)
        for _ in range(MAX_CLIMBS):
            stiffer = fit_best([change_point(best.point, {multimodal: 1.5, "gap": wider}) for wider in (1.0, 1.4)])
            if stiffer.cost > best.cost * CLIMB_RATIO:
                break
            best = stiffer
        point = best.point
    shootings = [replace(shooting, step=FINE_STEP) for shooting in prepare_segments(windows, point)]
    return _make_model(fit_shooting(shootings, point))


def add_standard_errors(windows: Sequence[Windows], model: Model) -> Model:
    """Return the model with standard errors from the spread of the segments; unchanged if these are too few."""
    point = Point.from_model(model)
    if _lacks_segments(windows, point):
        return model
    return _make_model(FittedShooting(point, prepare_segments(windows, point)))


def prepare_segments(windows: Sequence[Windows], point: Point, share: int = 1) -> tuple[Shooting, ...]:
    """Return segments of each recording with the best initial states for a point; a fit uses `share` 1.

    A larger `share` selects one in `share` of these segments.
    """
    first = [list_adjacent_segments(w) for w in windows]
    step = share * -(-sum(len(k) for k in first) // MAX_SEGMENTS)
    starts = (start_shooting(w, point, k[::step]) for w, k in zip(windows, first, strict=True))
    return tuple(initialise_states(shooting, point)[0] for shooting in starts)


def _lacks_segments(windows: Sequence[Windows], point: Point) -> bool:
    """Return whether the recordings have too few segments for the parameters."""
    return sum(len(list_adjacent_segments(w)) for w in windows) < MIN_SEGMENTS * len(point.values)


def _make_model(place: FittedShooting) -> Model:
    """Return the fitted model with standard errors from the spread of the segments."""
    slopes = _linearise(place.shootings, place.point)
    covariance = compute_robust_covariance(slopes.by_parameter, slopes.error, slopes.segment)
    return make_model_with_covariance(place.point, covariance)


def change_point(point: Point, factors: Mapping[str, float]) -> Point:
    """Return the point with nonlinear parameters of the link multiplied by factors, by name."""

    def change_term(term: Term) -> Term:
        if not term.link:
            return term
        parameters = [parameter for parameter in term.nonlinear_parameters if parameter.name in factors]
        return set_values(term, parameters, [factors[s.name] * term.nonlinear_values[s.name] for s in parameters])

    return point._replace(terms=tuple(change_term(term) for term in point.terms))


def add_link_gravity(point: Point) -> Point:
    """Return the point with gravity set to the link's gravity per inertia times its inertia.

    A point without these parameters is unchanged.
    """
    names = [column.name for term in point.terms for column in term.columns]
    term = find_link(point.terms)
    if "gravity" not in names or "gravity" not in term.nonlinear_values or term.id not in names:
        return point
    theta = point.theta.copy()
    theta[names.index("gravity")] = theta[names.index(term.id)] * term.nonlinear_values["gravity"]
    return point._replace(theta=theta)


def add_link_friction(point: Point, share: float) -> Point:
    """Return the point with a share of the joint's dry and viscous friction in its last term, a link."""
    link, joint = point.terms[-1], point.linear_values
    joint_names = {"friction": "coulomb", "viscous": "viscous"}
    parameters = [parameter for parameter in link.nonlinear_parameters if parameter.name in joint_names]
    of_inertia = share / max(point.theta[-1], 1e-9)
    term = set_values(link, parameters, [of_inertia * joint.get(joint_names[p.name], 0.0) for p in parameters])
    return point._replace(terms=(*point.terms[:-1], term))
