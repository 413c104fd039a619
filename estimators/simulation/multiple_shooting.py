"""Multiple shooting: initial states of many short segments are fitted together with the parameters (Gauss-Newton).

Source: Bock, Randwertproblemmethoden zur Parameteridentifizierung, 1987; for the elimination of the states, Golub and
Pereyra, Inverse Problems 19(2), 2003.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.regression.least_squares import robust_covariance
from estimators.simulation.link_segments import (
    DAMPING,
    Shooting,
    consecutive,
    cut,
    each,
    initialise,
    link_of,
    refine_states,
    slopes_by_state,
    state_steps,
)
from estimators.simulation.output_error import SMALLEST, Point, named, trust
from estimators.weak_form.shapes import moved
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model, Term

FEWEST = 2  # segments for each parameter
MOST = 120  # segments in a fit of parameters
FINE = 0.25e-3  # [s], step of the final integration: torque jumps at a contact
DIFFERENCE = 1e-2  # relative change of a parameter for derivatives, large enough to move contacts by a step
SHARES = (1.0, 0.4, 0.1, 0.0)  # tried of a step of the parameters
LARGEST = 0.3  # relative change of a parameter in a step
TURNS, TRIAL_TURNS, FINE_TURNS = 25, 6, 8
STIFFER = (1.0, 1.8)  # times the contact's stiffness: starts of a fit
CLIMBS, CLIMB = 4, 0.9  # trials of a stiffer and wider play, and ratio of errors that each has to reach
GAIN = 0.01  # share by which an iteration has to lower the squared error
STEEP = 10.0  # times the usual slope: beyond it a segment nearly misses a contact, and its weight is reduced


@dataclass(frozen=True)
class Slopes:
    """Errors (M,) of all segments in a row and their derivatives by relative changes of the parameters (M, P).

    The part that other initial states would explain is projected out of both; segments that diverge or nearly miss a
    contact have lower weights.

    Attributes:
        error: weighted.
        by_parameter: weighted.
        segment: that each row belongs to (M,).
        weights: of the segments of each recording (B,).
        parts: for each recording errors (B, N), derivatives by the parameters (B, N, P) and by the states (B, N, S).
    """

    error: Array
    by_parameter: Array
    segment: Index
    weights: tuple[Array, ...]
    parts: tuple[tuple[Array, Array, Array], ...]


def _linearise(every: Sequence[Shooting], point: Point) -> Slopes:
    values = point.values
    size = np.maximum(np.abs(values), SMALLEST)
    nearby = [point.at(values + DIFFERENCE * size * direction) for direction in np.eye(len(values))]
    parts = []
    for shooting in every:
        (error,), (by_state,) = slopes_by_state(shooting, [point], shooting.states[None])
        near = shooting.errors(nearby, np.repeat(shooting.states[None], len(nearby), axis=0))
        parts.append((error, np.moveaxis((near - error) / DIFFERENCE, 0, 2), by_state))
    free = [_project(*move) for move in parts]
    steep = [np.linalg.norm(slopes, axis=1) for _, slopes in free]  # (B, P)
    limit = STEEP * np.median(np.concatenate(steep), axis=0)
    steady = [(limit / (np.maximum(own, limit) + 1e-300)).min(axis=1) for own in steep]
    weights = tuple(trust([np.sqrt(np.mean(error**2, axis=1)) for error, _, _ in parts]))
    root = [np.sqrt(w) * s for w, s in zip(weights, steady, strict=True)]
    counts = np.concatenate([np.full(len(error), error.shape[1]) for error, _, _ in parts])
    return Slopes(
        np.concatenate([(r[:, None] * error).ravel() for r, (error, _) in zip(root, free, strict=True)]),
        np.concatenate([(r[:, None, None] * s).reshape(-1, len(values)) for r, (_, s) in zip(root, free, strict=True)]),
        np.repeat(np.arange(len(counts)), counts),
        weights,
        tuple(parts),
    )


def _project(error: Array, by_parameter: Array, by_state: Array) -> tuple[Array, Array]:
    """Errors (B, N) and derivatives (B, N, P) with the states' (B, N, S) part projected out."""
    frames, _ = np.linalg.qr(by_state / (np.linalg.norm(by_state, axis=1, keepdims=True) + 1e-300))
    both = np.concatenate([error[:, :, None], by_parameter], axis=2)
    both = both - frames @ (np.swapaxes(frames, 1, 2) @ both)
    return both[:, :, 0], both[:, :, 1:]


def fit(every: Sequence[Shooting], point: Point, turns: int = TURNS) -> tuple[Point, list[Shooting], float]:
    """Parameters and states that fit the segments of all recordings best, and their squared error."""
    every, stalled, cost = list(every), 0, np.inf
    for _ in range(turns):
        values, slopes = point.values, _linearise(every, point)
        size = np.maximum(np.abs(values), SMALLEST)
        damping = np.diag(0.01 * np.linalg.norm(slopes.by_parameter, axis=0) + 1e-12)
        target = np.concatenate([-slopes.error, np.zeros(len(values))])
        step = np.linalg.lstsq(np.vstack([slopes.by_parameter, damping]), target, rcond=None)[0]
        step = np.clip(step, -LARGEST, LARGEST)
        points = [point.at(values + share * step * size) for share in SHARES]
        tried = [_follow(shooting, points, step, move) for shooting, move in zip(every, slopes.parts, strict=True)]
        costs = [w @ squares.T for (_, _, squares), w in zip(tried, slopes.weights, strict=True)]
        best = int(np.argmin(np.sum(costs, axis=0)))
        cost = float(np.sum(costs, axis=0)[best])
        before = sum(
            float(w @ np.sum(move[0] ** 2, axis=1)) for w, move in zip(slopes.weights, slopes.parts, strict=True)
        )
        point = points[best]
        every = [
            replace(shooting, states=states[best], damping=damped[best])
            for shooting, (states, damped, _) in zip(every, tried, strict=True)
        ]
        if cost > before * (1 - GAIN):
            initialised = [initialise(shooting, point) for shooting in every]
            every = [shooting for shooting, _ in initialised]
            anew = sum(float(w @ squares) for w, (_, squares) in zip(slopes.weights, initialised, strict=True))
            stalled = stalled + 1 if anew > cost * (1 - GAIN) else 0
            if stalled == 2:
                break
    return point, every, cost


def _follow(
    shooting: Shooting, points: Sequence[Point], step: Array, move: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """States, their damping and squared errors (V, B) when the parameters take each share of a step."""
    error, by_parameter, by_state = move
    expected = [error + share * (by_parameter @ step) for share in SHARES]
    stay = np.repeat(shooting.states[None], len(points), axis=0)
    tried = np.array([shooting.states + state_steps(one, by_state, shooting.damping) for one in expected])
    tried = np.concatenate([tried, stay[:, None]], axis=1)
    squares = np.sum(shooting.errors(each(points, tried.shape[1]), tried.reshape(-1, *stay.shape[1:])) ** 2, axis=2)
    best = np.argmin(squares.reshape(*tried.shape[:2], -1), axis=1)[:, None]
    states = np.take_along_axis(tried, best[:, :, None], 1)[:, 0]
    factors = np.append(DAMPING, DAMPING[-1])[best[:, 0]]
    return refine_states(shooting, points, states, np.clip(shooting.damping * factors, 1e-6, 1e3), 1)


def estimate(every: Sequence[Windows], model: Model) -> Model:
    """The model with parameters fitted by multiple shooting; standard errors from the spread of the segments.

    Args:
        every: recording's windows.
        model: initial guess; one of its terms has a link. It is returned unchanged if segments are too few.
    """
    point = Point(model.terms, model.theta)
    first = [consecutive(windows) for windows in every]
    if sum(len(one) for one in first) < FEWEST * len(point.values):
        return model
    thinned = -(-sum(len(one) for one in first) // MOST)

    def fitted(point: Point, step: int, turns: int = TURNS) -> tuple[Point, list[Shooting], float]:
        return fit(
            [initialise(cut(w, point, one[::step]), point)[0] for w, one in zip(every, first, strict=True)],
            point,
            turns,
        )

    multimodal = link_of(model.terms).multimodal
    if multimodal:  # a loose contact has local minima at several stiffnesses, and windows favour a soft one

        def tried(starts: Sequence[Point]) -> tuple[Point, float]:
            found = [fitted(start, 3 * thinned, TRIAL_TURNS) for start in starts]
            best, _, cost = min(found, key=lambda one: one[2])
            return best, cost

        point, cost = tried([changed(start, {multimodal: f}) for start in (point, hung(point)) for f in STIFFER])
        for _ in range(CLIMBS):
            other, lower = tried([changed(point, {multimodal: 1.5, "gap": wider}) for wider in (1.0, 1.4)])
            if lower > cost * CLIMB:
                break
            point, cost = other, lower
    point, shooting, _ = fitted(point, thinned)
    if multimodal:
        point, shooting, _ = fit([replace(one, step=FINE) for one in shooting], point, FINE_TURNS)
    slopes = _linearise(shooting, point)
    return named(point, robust_covariance(slopes.by_parameter, slopes.error, slopes.segment))


def changed(point: Point, factors: Mapping[str, float]) -> Point:
    """A point with shape parameters of the link's term, where it has them, changed by factors."""

    def other(term: Term) -> Term:
        shapes = [shape for shape in term.shapes if shape.name in factors]
        return moved(term, shapes, [factors[s.name] * term.shape[s.name] for s in shapes]) if term.link else term

    return replace(point, terms=tuple(other(term) for term in point.terms))


def hung(point: Point) -> Point:
    """A point with the gravity that the link has."""
    names = [column.name for term in point.terms for column in term.columns]
    term = link_of(point.terms)
    if "gravity" not in names or "gravity" not in term.shape or term.id not in names:
        return point
    theta = point.theta.copy()
    theta[names.index("gravity")] = theta[names.index(term.id)] * term.shape["gravity"]
    return replace(point, theta=theta)
