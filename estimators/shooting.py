"""Multiple shooting: the state at the start of many short flights is fitted, with the parameters or for given ones.

Nobody measures the link behind a loose transmission. Carried along the measured motion from the start of a recording,
its state is lost after a few bounces, each of which magnifies what the one before was wrong by. Flights of a quarter of
a second forgive that: what the motor does in them tells where the link is. Parameters and states are moved together
(Gauss-Newton, each flight's state damped by its own Levenberg-Marquardt factor); starts that got stuck on the wrong
side of the play are tried anew from the other.

Source: Bock, Randwertproblemmethoden zur Parameteridentifizierung, 1987; for the elimination of the states, Golub and
Pereyra, Inverse Problems 19(2), 2003.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.free_running import Flights, stacked, start_memory
from estimators.least_squares import robust_covariance
from estimators.output_error import GRAIN, SMALLEST, Point, named
from estimators.windows import Windows
from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.physics import Model, Samples, Term, Trajectory, simulate
from pendulum_env.physics.term import Memory

HOP = 0.25  # [s], length of a flight
FEWEST = 2  # flights for each parameter
MOST = 120  # flights that parameters are fitted to
STEPS = (
    1e-3,
    0.25e-3,
)  # [s], of the integrator: coarse on the way, then fine, as contacts set in with a jump of torque
DIFFERENCE = 1e-2  # relative change of a parameter for derivatives, large enough to move contacts by a step
NUDGE = np.array([3e-4, 3e-3, 1e-3, 1e-2])  # the same of position and velocity of motor and link [rad], [rad/s]
SHARES = (1.0, 0.4, 0.1, 0.0)  # of a step of the parameters that are tried,
LARGEST = 0.3  # relative change of a parameter in a step
DAMPING = np.array([0.01, 1.0, 100.0])  # factors on the damping of a state that are tried
TURNS, TRIAL_TURNS, FINE_TURNS, LAUNCHES = 25, 6, 8, 2
STIFFER = (1.0, 1.8)  # times the contact's stiffness, from which a fit starts
CLIMBS, CLIMB = 4, 0.9  # times a stiffer and wider play is tried, and share to which that has to lower the error
GAIN = 0.01  # share by which a turn has to lower the squared error
STEEP = 10.0  # times the usual slope, beyond which a flight is about to miss a contact, and counts less


@dataclass(frozen=True)
class Shots:
    """Flights of one recording with the states (S, B) that they start from: q, q', then the hidden ones."""

    flights: Flights
    states: Array
    damping: Array  # (B,)
    step: float = STEPS[0]  # [s], longest of the integrator

    @property
    def measured(self) -> Array:
        """Positions to compare with (N, B) [rad]."""
        return self.flights.position[self.grain :: self.grain]

    @property
    def grain(self) -> int:
        """Samples from one compared position to the next."""
        return max(1, round(GRAIN * self.flights.windows.recording.rate))

    def fly(self, points: Sequence[Point], states: Array, remember: bool = False) -> Trajectory:
        """Flights of V points from V sets of states (V, S, B), each (N + 1, V B)."""
        flights, count = self.flights, states.shape[2]
        terms, theta = stacked([(point.terms, point.theta) for point in points], count)
        memory: dict[str, Memory] = {}
        for variants in zip(*(point.terms for point in points), strict=True):
            if not (variants[0].link or variants[0].delay):
                memory.update(start_memory([flights], variants))
        q, v, *hidden = (row.ravel() for row in np.swapaxes(states, 0, 1))
        memory[link_of(points[0].terms).id] = tuple(hidden)
        recording = flights.windows.recording
        return simulate(
            terms,
            theta,
            1.0 / recording.rate,
            np.concatenate([flights.command(sum(term.delay for term in point.terms)) for point in points], axis=1),
            q,
            v,
            np.tile(recording.time[flights.first], len(points)),
            memory=memory,
            longest_step=self.step,
            remember=remember,
        )

    def errors(self, points: Sequence[Point], states: Array) -> Array:
        """Errors of position of V points from V sets of states (V, S, B), each (V, B, N) [rad]."""
        path = self.fly(points, states).position[self.grain :: self.grain]
        return np.moveaxis(path.reshape(len(path), len(points), -1) - self.measured[:, None], 0, 2)


def _each(points: Sequence[Point], times: int) -> list[Point]:
    """Every point several times in a row."""
    return [point for point in points for _ in range(times)]


def has_link(terms: Sequence[Term]) -> bool:
    """Whether one of the terms has a link behind the motor, whose motion nobody measures."""
    return any(term.link for term in terms)


def link_of(terms: Sequence[Term]) -> Term:
    """The first term that has a link."""
    return next(term for term in terms if term.link)


def cut(windows: Windows, point: Point, first: Index) -> Shots:
    """Flights from given samples on, started as the measured motion suggests."""
    recording = windows.recording
    index = first + np.arange(length(windows) + 1)[:, None]
    position = np.vstack([windows.samples.position[first], recording.position[index[1:]]])
    flights = Flights(windows, first, recording.torque[index[:-1]], position, windows.samples.velocity[first])
    hidden = start_memory([flights], [link_of(point.terms)])[link_of(point.terms).id]
    return Shots(flights, np.array([position[0], flights.velocity, *hidden]), np.full(len(first), DAMPING[0]))


def tiles(windows: Windows) -> Index:
    """First samples of flights that follow each other all along a part of a recording."""
    last = windows.stop - length(windows) - 1
    return np.unique(np.append(np.arange(windows.first, last, length(windows)), last))


def length(windows: Windows) -> int:
    """Periods in a flight."""
    return min(max(1, round(HOP * windows.recording.rate)), windows.stop - windows.first - 1)


# ---------------------------------------------------------------------------------------------------------- states


def _slopes(shots: Shots, points: Sequence[Point], states: Array) -> tuple[Array, Array]:
    """Errors (V, B, N) of V points from V sets of states (V, S, B), and derivatives by the states (V, B, N, S)."""
    count, size, flights = states.shape
    nudged = states[:, None] + np.vstack([np.zeros(size), np.diag(NUDGE)])[None, :, :, None]
    errors = shots.errors(_each(points, size + 1), nudged.reshape(-1, size, flights))
    errors = errors.reshape(count, size + 1, flights, -1)
    return errors[:, 0], np.moveaxis((errors[:, 1:] - errors[:, :1]) / NUDGE[:, None, None], 1, 3)


def _moves(error: Array, slopes: Array, damping: Array) -> Array:
    """Steps of the states (F, S, B) that lower the errors (B, N) of B flights, for each of F factors on the damping."""
    square = np.swapaxes(slopes, 1, 2) @ slopes
    own = np.einsum("bss->bs", square)[:, :, None] * np.eye(slopes.shape[2])
    pull = np.einsum("bns,bn->bs", slopes, error)[:, :, None]
    steps = [
        -np.linalg.solve(square + (d * damping)[:, None, None] * own + 1e-16 * np.eye(own.shape[1]), pull)
        for d in DAMPING
    ]
    return np.array([step[:, :, 0].T for step in steps])


def settle(
    shots: Shots, points: Sequence[Point], states: Array, damping: Array, turns: int
) -> tuple[Array, Array, Array]:
    """States (V, S, B), their damping (V, B) and squared errors (V, B) after some turns, for each of V points."""
    for _ in range(turns):
        error, slopes = _slopes(shots, points, states)
        before = np.sum(error**2, axis=2)
        tried = np.array(
            [s + _moves(*one) for s, *one in zip(states, error, slopes, damping, strict=True)]
        )  # (V, F, S, B)
        flat = tried.reshape(-1, *states.shape[1:])
        after = np.sum(shots.errors(_each(points, len(DAMPING)), flat) ** 2, axis=2)
        states, damping, squares = _best(tried, after.reshape(*tried.shape[:2], -1), states, before, damping)
    return states, damping, squares


def _best(tried: Array, after: Array, states: Array, before: Array, damping: Array) -> tuple[Array, Array, Array]:
    """The best of F states tried for each flight (V, F, S, B), or the old ones where none is better."""
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


def launch(shots: Shots, point: Point) -> tuple[Shots, Array]:
    """The flights from the best states there are for a point, and their squared errors (B,).

    Tried are the states they have, those that the measured motion suggests, and a link on either side of the play.
    """
    traced = cut(shots.flights.windows, point, shots.flights.first).states
    gap = link_of(point.terms).shape.get("gap", 0.0)
    candidates = [shots.states, traced]
    for side in (-1, 0, 1) if gap else ():
        candidates.append(np.array([traced[0], traced[1], traced[0] + side * gap, traced[1]]))
    start = np.full((len(candidates), traced.shape[1]), DAMPING[0])
    states, damping, squares = settle(shots, [point] * len(candidates), np.array(candidates), start, LAUNCHES)
    best, flight = np.argmin(squares, axis=0), np.arange(len(start[0]))
    states, _, squares = settle(shots, [point], states[best, :, flight].T[None], damping[best, flight][None], LAUNCHES)
    return replace(shots, states=states[0], damping=start[0]), squares[0]


# ------------------------------------------------------------------------------------------------------ parameters


@dataclass(frozen=True)
class Slopes:
    """Errors (M,) of all flights in a row and their derivatives by relative changes of the parameters (M, P).

    What other states at the start would explain is taken out of both; flights that go astray or are about to miss a
    contact are weighted down.

    Attributes:
        error: weighted.
        by_parameter: weighted.
        flight: that each row belongs to (M,).
        weights: of the flights of each recording (B,).
        moves: for each recording errors (B, N), derivatives by the parameters (B, N, P) and by the states (B, N, S).
    """

    error: Array
    by_parameter: Array
    flight: Index
    weights: tuple[Array, ...]
    moves: tuple[tuple[Array, Array, Array], ...]


def _linearise(every: Sequence[Shots], point: Point) -> Slopes:
    values = point.values
    size = np.maximum(np.abs(values), SMALLEST)
    nearby = [point.at(values + DIFFERENCE * size * direction) for direction in np.eye(len(values))]
    moves = []
    for shots in every:
        (error,), (by_state,) = _slopes(shots, [point], shots.states[None])
        near = shots.errors(nearby, np.repeat(shots.states[None], len(nearby), axis=0))
        moves.append((error, np.moveaxis((near - error) / DIFFERENCE, 0, 2), by_state))
    free = [_project(*move) for move in moves]
    spread = [np.sqrt(np.mean(error**2, axis=1)) for error, _, _ in moves]
    usual = 3 * float(np.median(np.concatenate(spread))) + 1e-12
    steep = [np.linalg.norm(slopes, axis=1) for _, slopes in free]  # (B, P)
    limit = STEEP * np.median(np.concatenate(steep), axis=0)
    trust = [np.minimum(1.0, limit / (own + 1e-300)).min(axis=1) for own in steep]
    weights = tuple(1 / (1 + (own / usual) ** 2) for own in spread)
    root = [np.sqrt(w) * t for w, t in zip(weights, trust, strict=True)]
    counts = np.concatenate([np.full(len(error), error.shape[1]) for error, _, _ in moves])
    return Slopes(
        np.concatenate([(r[:, None] * error).ravel() for r, (error, _) in zip(root, free, strict=True)]),
        np.concatenate([(r[:, None, None] * s).reshape(-1, len(values)) for r, (_, s) in zip(root, free, strict=True)]),
        np.repeat(np.arange(len(counts)), counts),
        weights,
        tuple(moves),
    )


def _project(error: Array, by_parameter: Array, by_state: Array) -> tuple[Array, Array]:
    """Errors (B, N) and derivatives (B, N, P) less what the states (B, N, S) explain."""
    frames, _ = np.linalg.qr(by_state / (np.linalg.norm(by_state, axis=1, keepdims=True) + 1e-300))
    both = np.concatenate([error[:, :, None], by_parameter], axis=2)
    both = both - frames @ (np.swapaxes(frames, 1, 2) @ both)
    return both[:, :, 0], both[:, :, 1:]


def fit(every: Sequence[Shots], point: Point, turns: int = TURNS) -> tuple[Point, list[Shots], float]:
    """Parameters and states that fit the flights of all recordings best, and their squared error."""
    every, stalled, cost = list(every), 0, np.inf
    for _ in range(turns):
        values, slopes = point.values, _linearise(every, point)
        size = np.maximum(np.abs(values), SMALLEST)
        damping = np.diag(0.01 * np.linalg.norm(slopes.by_parameter, axis=0) + 1e-12)
        target = np.concatenate([-slopes.error, np.zeros(len(values))])
        step = np.linalg.lstsq(np.vstack([slopes.by_parameter, damping]), target, rcond=None)[0]
        step = np.clip(step, -LARGEST, LARGEST)
        points = [point.at(values + share * step * size) for share in SHARES]
        tried = [_follow(shots, points, step, move) for shots, move in zip(every, slopes.moves, strict=True)]
        costs = [w @ squares.T for (_, _, squares), w in zip(tried, slopes.weights, strict=True)]
        best = int(np.argmin(np.sum(costs, axis=0)))
        cost = float(np.sum(costs, axis=0)[best])
        before = sum(
            float(w @ np.sum(move[0] ** 2, axis=1)) for w, move in zip(slopes.weights, slopes.moves, strict=True)
        )
        point = points[best]
        every = [
            replace(shots, states=states[best], damping=damped[best])
            for shots, (states, damped, _) in zip(every, tried, strict=True)
        ]
        if cost > before * (1 - GAIN):
            launched = [launch(shots, point) for shots in every]
            every = [shots for shots, _ in launched]
            anew = sum(float(w @ squares) for w, (_, squares) in zip(slopes.weights, launched, strict=True))
            stalled = stalled + 1 if anew > cost * (1 - GAIN) else 0
            if stalled == 2:
                break
    return point, every, cost


def _follow(
    shots: Shots, points: Sequence[Point], step: Array, move: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """States, their damping and squared errors (V, B) when the parameters take each share of a step."""
    error, by_parameter, by_state = move
    expected = [error + share * (by_parameter @ step) for share in SHARES]
    stay = np.repeat(shots.states[None], len(points), axis=0)
    tried = np.array([shots.states + _moves(one, by_state, shots.damping) for one in expected])
    tried = np.concatenate([tried, stay[:, None]], axis=1)
    squares = np.sum(shots.errors(_each(points, tried.shape[1]), tried.reshape(-1, *stay.shape[1:])) ** 2, axis=2)
    best = np.argmin(squares.reshape(*tried.shape[:2], -1), axis=1)[:, None]
    states = np.take_along_axis(tried, best[:, :, None], 1)[:, 0]
    factors = np.append(DAMPING, DAMPING[-1])[best[:, 0]]
    return settle(shots, points, states, np.clip(shots.damping * factors, 1e-6, 1e3), 1)


def estimate(every: Sequence[Windows], model: Model) -> Model:
    """The model with parameters fitted by multiple shooting; standard errors from the spread of the flights.

    Args:
        every: recording's windows.
        model: to start from; one of its terms has a link. It is returned as it is where flights are too few.
    """
    point = Point(model.terms, model.theta)
    first = [tiles(windows) for windows in every]
    if sum(len(one) for one in first) < FEWEST * len(point.values):
        return model
    thinned = -(-sum(len(one) for one in first) // MOST)

    def fitted(point: Point, step: int, turns: int = TURNS) -> tuple[Point, list[Shots], float]:
        return fit(
            [launch(cut(w, point, one[::step]), point)[0] for w, one in zip(every, first, strict=True)], point, turns
        )

    rugged = link_of(model.terms).rugged
    if rugged:  # a loose contact has its own minimum for many a stiffness, and the windows prefer a soft one

        def tried(starts: Sequence[Point]) -> tuple[Point, float]:
            found = [fitted(start, 3 * thinned, TRIAL_TURNS) for start in starts]
            best, _, cost = min(found, key=lambda one: one[2])
            return best, cost

        point, cost = tried([changed(start, {rugged: f}) for start in (point, hung(point)) for f in STIFFER])
        for _ in range(CLIMBS):
            other, lower = tried([changed(point, {rugged: 1.5, "gap": wider}) for wider in (1.0, 1.4)])
            if lower > cost * CLIMB:
                break
            point, cost = other, lower
    point, shots, _ = fitted(point, thinned)
    if rugged:
        point, shots, _ = fit([replace(one, step=STEPS[1]) for one in shots], point, FINE_TURNS)
    slopes = _linearise(shots, point)
    return named(point, np.sqrt(np.diag(robust_covariance(slopes.by_parameter, slopes.error, slopes.flight))))


def changed(point: Point, factors: Mapping[str, float]) -> Point:
    """A point with shape parameters of the link's term, where it has them, changed by factors."""

    def other(term: Term) -> Term:
        known = {name: factor * term.shape[name] for name, factor in factors.items() if name in term.shape}
        return replace(term, **known) if term.link else term

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


# -------------------------------------------------------------------------------------------------------- watching


def watch(windows: Windows, model: Model) -> Samples:
    """Samples of a recording with the motion of motor and link as flights that follow each other have it."""
    point, term = Point(model.terms, model.theta), link_of(model.terms)
    x = windows.trace([term])[0]
    shots, _ = launch(cut(windows, point, tiles(windows)), point)
    path = shots.fly([point], shots.states[None], remember=True)
    index = shots.flights.first + np.arange(len(path.position))[:, None]

    def filled(measured: ArrayLike, simulated: Array) -> Array:
        series = np.array(measured, dtype=float)
        series[index] = simulated
        return series

    assert path.memory is not None
    link = tuple(filled(old, new) for old, new in zip(x.memory[term.id], path.memory[term.id], strict=True))
    q, v = filled(x.position, path.position), filled(x.velocity, path.velocity)
    return replace(x, position=q, velocity=v, memory={term.id: link})


def hidden_state(flights: Flights, x: Samples, term: Term) -> Memory:
    """State of a link at the start of flights, as far from the measured motor as it is from the one that is watched."""
    position, velocity = (series[flights.first] for series in x.memory[term.id])
    q, v = np.asarray(x.position)[flights.first], np.asarray(x.velocity)[flights.first]
    return flights.position[0] + position - q, flights.velocity + velocity - v
