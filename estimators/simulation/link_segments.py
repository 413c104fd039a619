"""Short segments with fitted initial states: the motion of the motor in them gives the state of the link behind it.

The link of a loose transmission is not measured. Propagated along the measured motion from the start of a recording,
its state is lost after a few bounces, since each amplifies the error of the one before. In segments of a quarter of a
second errors stay bounded (Levenberg-Marquardt, with a damping for each segment); initial states that converged to the
wrong side of the play are restarted from the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.simulation.free_running import Segments, cut_segments, periods, simulated, start_memory, stretches
from estimators.simulation.output_error import Point, grain_of
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.physics import Model, Samples, Term, Trajectory
from pendulum_env.physics.term import Memory

LENGTH = 0.25  # [s], length of a segment
COARSE = 1e-3  # [s], step of the integrator
PERTURBATION = np.array(
    [3e-4, 3e-3, 1e-3, 1e-2]
)  # of position and velocity of motor and link, for derivatives [rad], [rad/s]
DAMPING = np.array([0.01, 1.0, 100.0])  # factors tried on the damping of a state
INITIAL_TURNS = 2  # iterations for every start, and as many for the best


@dataclass(frozen=True)
class Shooting:
    """Segments of one recording with their initial states (S, B): q, q', then the hidden ones."""

    segments: Segments
    states: Array
    damping: Array  # (B,)
    step: float = COARSE  # [s], longest of the integrator

    @property
    def measured(self) -> Array:
        """Positions to compare with (N, B) [rad]."""
        grain = grain_of(self.segments)
        return self.segments.position[grain::grain]

    def simulate(
        self, points: Sequence[Point], states: Array, observe: Callable[[Samples], None] | None = None
    ) -> Trajectory:
        """Segments of V points from V sets of states (V, S, B), each (N + 1, V B); `observe` as in `simulate`."""
        q, v, *hidden = (row.ravel() for row in np.swapaxes(states, 0, 1))
        models = [(point.terms, point.theta) for point in points]
        link = {link_of(points[0].terms).id: tuple(hidden)}
        return simulated([self.segments], models, q, v, link, self.step, observe)

    def errors(self, points: Sequence[Point], states: Array) -> Array:
        """Errors of position of V points from V sets of states (V, S, B), each (V, B, N) [rad]."""
        grain = grain_of(self.segments)
        path = self.simulate(points, states).position[grain::grain]
        return np.moveaxis(path.reshape(len(path), len(points), -1) - self.measured[:, None], 0, 2)


def each(points: Sequence[Point], times: int) -> list[Point]:
    """Every point several times in a row."""
    return [point for point in points for _ in range(times)]


def has_link(terms: Sequence[Term]) -> bool:
    """Whether one of the terms has a link behind the motor, whose motion is not measured."""
    return any(term.link for term in terms)


def link_of(terms: Sequence[Term]) -> Term:
    """The first term that has a link."""
    return next(term for term in terms if term.link)


def cut(windows: Windows, point: Point, first: Index) -> Shooting:
    """Segments from given samples on, with initial states from the measured motion."""
    segments, link = cut_segments(windows, first, periods(windows, LENGTH)), link_of(point.terms)
    hidden = start_memory([segments], [link])[link.id]
    return Shooting(
        segments, np.array([segments.position[0], segments.velocity, *hidden]), np.full(len(first), DAMPING[0])
    )


def consecutive(windows: Windows) -> Index:
    """First samples of adjacent segments along a part of a recording."""
    length = periods(windows, LENGTH)
    ends = [(begin, end - length - 1) for begin, end in stretches(windows)]
    return np.concatenate([np.unique(np.append(np.arange(b, last, length), last)) for b, last in ends if last >= b])


def slopes_by_state(shooting: Shooting, points: Sequence[Point], states: Array) -> tuple[Array, Array]:
    """Errors (V, B, N) of V points from V sets of states (V, S, B), and derivatives by the states (V, B, N, S)."""
    count, size, segments = states.shape
    perturbed = states[:, None] + np.vstack([np.zeros(size), np.diag(PERTURBATION)])[None, :, :, None]
    errors = shooting.errors(each(points, size + 1), perturbed.reshape(-1, size, segments))
    errors = errors.reshape(count, size + 1, segments, -1)
    return errors[:, 0], np.moveaxis((errors[:, 1:] - errors[:, :1]) / PERTURBATION[:, None, None], 1, 3)


def state_steps(error: Array, slopes: Array, damping: Array) -> Array:
    """Levenberg-Marquardt steps of states (F, S, B) from errors (B, N) of B segments, for F factors on the damping."""
    square = np.swapaxes(slopes, 1, 2) @ slopes
    own = np.einsum("bss->bs", square)[:, :, None] * np.eye(slopes.shape[2])
    pull = np.einsum("bns,bn->bs", slopes, error)[:, :, None]
    steps = [
        -np.linalg.solve(square + (d * damping)[:, None, None] * own + 1e-16 * np.eye(own.shape[1]), pull)
        for d in DAMPING
    ]
    return np.array([step[:, :, 0].T for step in steps])


def refine_states(
    shooting: Shooting, points: Sequence[Point], states: Array, damping: Array, turns: int
) -> tuple[Array, Array, Array]:
    """States (V, S, B), their damping (V, B) and squared errors (V, B) after some turns, for each of V points."""
    for _ in range(turns):
        error, slopes = slopes_by_state(shooting, points, states)
        before = np.sum(error**2, axis=2)
        tried = np.array(
            [s + state_steps(*one) for s, *one in zip(states, error, slopes, damping, strict=True)]
        )  # (V, F, S, B)
        flat = tried.reshape(-1, *states.shape[1:])
        after = np.sum(shooting.errors(each(points, len(DAMPING)), flat) ** 2, axis=2)
        states, damping, squares = _best(tried, after.reshape(*tried.shape[:2], -1), states, before, damping)
    return states, damping, squares


def _best(tried: Array, after: Array, states: Array, before: Array, damping: Array) -> tuple[Array, Array, Array]:
    """The best of F states tried for each segment (V, F, S, B), or the old ones where none is better."""
    best = np.argmin(after, axis=1)[:, None]  # (V, 1, B)
    squares = np.take_along_axis(after, best, 1)[:, 0]
    better = squares < before
    moved = np.take_along_axis(tried, best[:, :, None], 1)[:, 0]
    bolder = np.clip(damping * DAMPING[best[:, 0]], 1e-6, 1e3)
    return (
        np.where(better[:, None], moved, states),
        np.where(better, bolder, np.minimum(30 * damping, 1e3)),
        np.minimum(squares, before),
    )


def initialise(shooting: Shooting, point: Point) -> tuple[Shooting, Array]:
    """The segments with the best initial states for a point, and their squared errors (B,).

    The starts are the present states, those from the measured motion, and a link on either side of the play.
    """
    traced = cut(shooting.segments.windows, point, shooting.segments.first).states
    gap = link_of(point.terms).shape.get("gap", 0.0)
    candidates = [shooting.states, traced]
    for side in (-1, 0, 1) if gap else ():
        candidates.append(np.array([traced[0], traced[1], traced[0] + side * gap, traced[1]]))
    start = np.full((len(candidates), traced.shape[1]), DAMPING[0])
    states, damping, squares = refine_states(
        shooting, [point] * len(candidates), np.array(candidates), start, INITIAL_TURNS
    )
    best, segment = np.argmin(squares, axis=0), np.arange(len(start[0]))
    states, _, squares = refine_states(
        shooting, [point], states[best, :, segment].T[None], damping[best, segment][None], INITIAL_TURNS
    )
    return replace(shooting, states=states[0], damping=start[0]), squares[0]


def watch(windows: Windows, model: Model) -> Samples:
    """Samples of a recording with the motion of motor and link simulated in adjacent segments."""
    point, term = Point(model.terms, model.theta), link_of(model.terms)
    x = windows.trace([term])[0]
    shooting, _ = initialise(cut(windows, point, consecutive(windows)), point)
    seen: list[Memory] = []
    path = shooting.simulate([point], shooting.states[None], lambda state: seen.append(state.memory[term.id]))
    index = shooting.segments.first + np.arange(len(path.position))[:, None]

    def filled(measured: ArrayLike, simulated: Array) -> Array:
        series = np.array(measured, dtype=float)
        series[index] = simulated
        return series

    moved = (np.array(series) for series in zip(*seen, strict=True))
    link = tuple(filled(old, new) for old, new in zip(x.memory[term.id], moved, strict=True))
    q, v = filled(x.position, path.position), filled(x.velocity, path.velocity)
    return replace(x, position=q, velocity=v, memory={term.id: link})


def hidden_state(segments: Segments, x: Samples, term: Term) -> Memory:
    """State of a link at the start of segments, at its estimated offset from the motor."""
    position, velocity = (series[segments.first] for series in x.memory[term.id])
    q, v = np.asarray(x.position)[segments.first], np.asarray(x.velocity)[segments.first]
    return segments.position[0] + position - q, segments.velocity + velocity - v
