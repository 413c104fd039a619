"""Across turns, where an equation's rows are of no use: the model itself moves on, from where the machine was.

Where a joint sticks or turns, rows are left out, as nobody knows within a sample in which direction friction acts. A
model does: it moves, sticks and turns by its own step. It is moved on through a fifth of a second around each turn,
from the position and velocity at the start that fit what was measured best (Gauss-Newton). What it misses is told as
an angle and as the constant torque that would make as much of a difference. As large as usual is noise of the encoder
in the one, noise of the torque in the other, even if the inertia has changed or the motion is another.

Source: Bock, Randwertproblemmethoden zur Parameteridentifizierung, 1987, for the fit of the state at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.physics import Term
from pendulum_env.physics.simulation import Balance, prepared, simulate

HALF = 0.1  # [s], before and after a turn
SHARES = np.array([1.0, 0.3, 0.0])  # of a step of the state at the start, that are tried
ROUNDS = 4
NUDGE = np.array([1e-5, 1e-3])  # of position [rad] and velocity [rad/s], for derivatives
DIFFERENCE, SMALLEST = 1e-3, 1e-3  # relative change of a parameter for derivatives, and least size of one
FITS = 3  # of parameters, with weights that follow from the fit before
LARGEST = 1e3  # times the least torque that matters, that no error is more than
FINEST = 1e-20  # [(rad/(N m))^2], so that nothing by nothing is a number
KEPT = 24  # turns
FEWEST = 3  # turns, before anything is usual
PRIOR, SCATTER = 4, 1.0  # turns' worth, and standard deviation of the log of a mean square before any is known
MEMORY = 300  # turns, of what is usual
MOST = 4.0  # standard deviations that a turn counts for
LEARNT = 2.0  # standard deviations that are learnt from one


@dataclass(frozen=True)
class Turns:
    """What was measured around S turns, over N periods.

    Attributes:
        time: at the start (S,) [s].
        position: (N + 1, S) [rad].
        velocity: at the start, as smoothed (S,) [rad/s].
        torque: over each period (N, S) [N m].
        before: torque over the periods before (M, S) [N m].
    """

    time: Array
    position: Array
    velocity: Array
    torque: Array
    before: Array

    @classmethod
    def joined(cls, turns: Sequence[Turns]) -> Turns:
        """Several beside each other."""
        return cls(*(np.concatenate([getattr(one, f.name) for one in turns], axis=-1) for f in fields(cls)))


@dataclass(frozen=True)
class Missed:
    """What a model misses S turns by, less what another state at the start would explain.

    Attributes:
        error: of the position (S, N + 1) [rad].
        by_parameter: its derivatives (S, N + 1, P).
        by_torque: its derivative by a constant torque (S, N + 1) [rad/(N m)].
    """

    error: Array
    by_parameter: Array
    by_torque: Array

    def sizes(self, least: ArrayLike) -> Array:
        """Log mean square of errors, in rad and in N m (S, 2); one of `least` [N m] does not matter, () or (S,)."""
        square, unit = (np.mean(values**2, axis=1) for values in (self.error, self.by_torque))
        unit = unit + square / (LARGEST * least) ** 2 + FINEST  # a joint that sticks hides any torque
        square = square + least**2 * unit
        return np.log(np.column_stack([square, square / unit]))

    def fitted(self, std: Array, usual: float) -> Missed:
        """With the parameters that explain most, as far as they are uncertain (P,), and the usual mean square."""
        delta = np.zeros(len(std))
        for _ in range(FITS):
            error = self.error + self.by_parameter @ delta
            weight = 1.0 / np.sqrt(usual + np.mean(error**2, axis=1))  # one that went astray counts little
            rows = (weight[:, None, None] * self.by_parameter).reshape(-1, len(std)) * std
            miss = (weight[:, None] * self.error).ravel()
            both = np.vstack([rows, np.eye(len(std))]), np.concatenate([-miss, np.zeros(len(std))])
            delta = std * np.linalg.lstsq(*both, rcond=None)[0]
        return replace(self, error=self.error + self.by_parameter @ delta)


class Passage:
    """A model on its way through S turns, one simulation after the other.

    Attributes:
        turns: that were measured.
        theta: parameters, one column for each turn (P, S).
    """

    def __init__(self, turns: Turns, theta: Array) -> None:
        """Take the turns and theta, (P,) for all or (P, S)."""
        count = len(turns.time)
        self.turns, self.theta = turns, np.broadcast_to(theta.reshape(len(theta), -1), (len(theta), count))
        self.state: Array = np.array([turns.position[0], turns.velocity])  # at the start (2, S)
        self.step: Array = np.zeros((2, count))  # of the state, to be tried
        self.error: Array = np.zeros(0)  # (S, N + 1, 1)
        self.frames: Array = np.zeros(0)  # of what other states at the start would do (S, N + 1, 2)
        self.rounds = 0


class Mover:
    """Moves a model through turns.

    Attributes:
        ready: whether it can: its laws are formulas, others would take too long; none of its terms remembers what was
            before a turn; and samples come often enough to tell what happens in one.
    """

    def __init__(self, terms: Sequence[Term], period: float) -> None:
        """Take the terms and the time between samples [s]."""
        self._terms, self._period = tuple(terms), period
        self._program = prepared(terms)
        remembers = Balance(terms, np.ones(sum(len(term.columns) for term in terms))).remembers
        self.ready = self._program.step is not None and not remembers and round(HALF / period) > 1

    def __reduce__(self) -> tuple[type[Mover], tuple[Sequence[Term], float]]:
        return Mover, (self._terms, self._period)  # a program cannot be pickled

    def missed(self, turns: Turns, theta: Array) -> Missed:
        """What the model with parameters theta, (P,) or (P, S), misses turns by."""
        passage, found = Passage(turns, theta), None
        while found is None:
            found = self.go_on(passage)
        return found

    def go_on(self, passage: Passage) -> Missed | None:
        """One more simulation; what is missed, once that is known."""
        if passage.rounds == ROUNDS:
            return self._compared(passage)
        turns, state = passage.turns, passage.state
        nudges = np.column_stack([np.zeros(2), np.diag(NUDGE)])  # (2, 3)
        shares = SHARES if passage.rounds else SHARES[:1]
        tried = state[:, None] + shares[:, None] * passage.step[:, None]  # (2, shares, S)
        paths = self._move(passage, (tried[:, :, None] + nudges[:, None, :, None]).reshape(2, -1))
        errors = paths.reshape(len(paths), len(shares), 3, -1) - turns.position[:, None, None]
        best = np.argmin(np.sum(errors[:, :, 0] ** 2, axis=0), axis=0)
        each = np.arange(len(best))
        nearby = errors[:, best, :, each]  # (S, N + 1, 3)
        error = nearby[..., :1]
        frames, triangle = np.linalg.qr((nearby[..., 1:] - error) / NUDGE)
        step = -np.linalg.solve(triangle + 1e-12 * np.eye(2), np.swapaxes(frames, 1, 2) @ error)[..., 0].T
        passage.state, passage.step = np.asarray(tried[:, best, each]), np.asarray(step)
        passage.error, passage.frames, passage.rounds = error, frames, passage.rounds + 1
        return None

    def _compared(self, passage: Passage) -> Missed:
        """Errors from the states that were found, and their derivatives."""
        turns, theta, error, frames = passage.turns, passage.theta, passage.error, passage.frames
        count, variants = len(turns.time), len(theta) + 1
        nudge = DIFFERENCE * np.maximum(np.abs(theta), SMALLEST)  # (P, S)
        push = DIFFERENCE * np.maximum(np.sqrt(np.mean(turns.torque**2, axis=0)), SMALLEST)
        thetas = np.repeat(theta[:, None], variants, axis=1)  # (P, P + 1, S)
        thetas[np.arange(len(theta)), np.arange(len(theta))] += nudge
        torque = np.repeat(turns.torque[:, None], variants, axis=1)
        torque[:, -1] += push
        states = np.repeat(passage.state[:, None], variants, axis=1).reshape(2, -1)
        paths = self._move(passage, states, thetas.reshape(len(theta), -1), torque.reshape(len(torque), -1))
        nearby = np.transpose(paths.reshape(-1, variants, count) - turns.position[:, None], (2, 0, 1))
        slopes = (nearby - error) / np.vstack([nudge, push]).T[:, None]
        both = np.concatenate([error, slopes], axis=2)
        both = both - frames @ (np.swapaxes(frames, 1, 2) @ both)
        return Missed(both[..., 0], both[..., 1:-1], both[..., -1])

    def _move(self, passage: Passage, states: Array, theta: Array | None = None, torque: Array | None = None) -> Array:
        """Positions (N + 1, V S) of V variants of all turns, from states (2, V S)."""
        turns = passage.turns
        times = states.shape[1] // len(turns.time)
        return simulate(
            self._terms,
            np.tile(passage.theta, times) if theta is None else theta,
            self._period,
            np.tile(turns.torque, times) if torque is None else torque,
            states[0],
            states[1],
            np.tile(turns.time, times),
            before=np.tile(turns.before, times),
            program=self._program,
        ).position


class Past:
    """The last turns of one pendulum, and how large errors of them are while the model holds."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._turns: list[Turns] = []
        self._learnt, self._mean, self._squares = 0, np.zeros(2), np.zeros(2)

    def keep(self, turn: Turns) -> None:
        """One more."""
        self._turns = [*self._turns[1 - KEPT :], turn]

    def since(self, time: float) -> Turns | None:
        """Those that began after some time [s], as far as they are kept; None if there are none."""
        found = [turn for turn in self._turns if turn.time[0] > time]
        return Turns.joined(found) if found else None

    def learn(self, size: Array) -> None:
        """One more size (2,) is usual."""
        bound = LEARNT * self._scatter if self._learnt >= FEWEST else np.inf
        step = np.clip(size - self._mean, -bound, bound)
        self._learnt = min(self._learnt + 1, MEMORY)
        share = 1.0 / self._learnt
        self._mean = self._mean + share * step
        kept = 1.0 if self._learnt < MEMORY else 1.0 - share
        self._squares = kept * (self._squares + (1.0 - share) * step**2)

    @property
    def _scatter(self) -> Array:
        return np.asarray(np.sqrt((PRIOR * SCATTER**2 + self._squares) / (PRIOR + self._learnt - 1)))

    @property
    def usual(self) -> float:
        """Mean square of errors [rad^2]."""
        return float(np.exp(self._mean[0]))

    def surprise(self, *sizes: Array) -> float:
        """By how many standard errors the mean of sizes (2,) is larger than usual, both in rad and in N m."""
        if self._learnt < FEWEST:
            return 0.0
        new = np.clip((np.array(sizes) - self._mean) / self._scatter, -MOST, MOST)
        return float(np.min(np.mean(new, axis=0)) / np.sqrt(1 / len(new) + 1 / self._learnt))


class TurnFinder:
    """Finds turns of B pendulums, as soon as all around them is measured."""

    def __init__(self, batch: int, period: float, delay: int, late: int, slowest: float) -> None:
        """Take B and the time between samples [s], how late velocities and torques come [samples], and the least speed.

        Below the least speed [rad/s], a velocity has no direction.
        """
        self._half, self._delay, self._late, self._slowest = round(HALF / period), delay, late, slowest
        self._ring = np.zeros((2 * self._half + delay + late + 2, 4, batch))  # time, position, torque, velocity
        self._free = np.zeros(batch, dtype=np.intp)  # sample from which on the next may begin
        self._count = 0

    def take(self, time: Array, position: Array, torque: Array, velocity: Array, place: Index) -> dict[int, Turns]:
        """Take in a sample, and the velocity `delay` samples ago, with its place in the run (B,) each."""
        ring, length, end = self._ring, len(self._ring), self._count - self._delay
        ring[self._count % length, :3] = time, position, torque
        ring[end % length, 3] = velocity
        self._count += 1
        turn, first = end - self._half, end - 2 * self._half
        reverses = (ring[turn % length, 3] > 0) != (ring[(turn - 1) % length, 3] > 0)
        if not reverses.any():
            return {}
        moves = np.maximum(np.abs(ring[first % length, 3]), np.abs(ring[end % length, 3])) > self._slowest
        due = np.flatnonzero(reverses & moves & (place > 2 * self._half + self._late) & (first >= self._free))
        self._free[due] = end
        rows = np.arange(first - self._late, end + 1) % length
        return {int(b): self._around(ring[rows, :, b]) for b in due}

    def _around(self, rows: Array) -> Turns:
        late, (time, position, torque, velocity) = self._late, rows.T[..., None]
        return Turns(time[late], position[late:], velocity[late], torque[late + 1 :], torque[1 : late + 1])
