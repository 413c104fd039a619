"""Simulation through reversals, where the rows of the regression are left out.

Rows exclude a joint that sticks or reverses, since the direction of friction within a sample is unknown. A simulation
includes both: the model is simulated through a fifth of a second around each reversal, from the best-fitting initial
position and velocity. Its prediction error is expressed as an angle and as an equivalent constant torque. Encoder noise
has a constant size in the former, torque noise in the latter, even after a change of inertia or motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from pendulum_env._typing import Array, ArrayLike, Index
from pendulum_env.arms.joints import body_of
from pendulum_env.physics import Term
from pendulum_env.physics.simulation import Balance, prepared, simulate

PERTURBATION = np.array([1e-5, 1e-3])  # of position [rad] and velocity [rad/s], for derivatives


@dataclass(frozen=True)
class ReversalSettings:
    """Numbers of the simulation through reversals."""

    half: float = 0.1  # [s], before and after a turn
    difference: float = 1e-3  # relative change of a parameter for derivatives
    smallest: float = 1e-3  # least size of a parameter, of which that is a share
    fits: int = 3  # of parameters, with weights that follow from the fit before
    largest: float = 1e3  # times the least torque that matters, limit of any error
    finest: float = 1e-20  # [(rad/(N m))^2], so that nothing by nothing is a number


TURN = ReversalSettings()


@dataclass(frozen=True)
class Turns:
    """Measurements around S reversals, over N periods.

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
    """Prediction errors of a model at S reversals, without the part due to the initial state.

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
        unit = unit + square / (TURN.largest * least) ** 2 + TURN.finest  # a joint that sticks hides any torque
        square = square + least**2 * unit
        return np.log(np.column_stack([square, square / unit]))

    def fitted(self, std: Array, usual: float) -> Missed:
        """With the parameters that explain most, as far as they are uncertain (P,), and the usual mean square."""
        delta = np.zeros(len(std))
        for _ in range(TURN.fits):
            error = self.error + self.by_parameter @ delta
            weight = 1.0 / np.sqrt(usual + np.mean(error**2, axis=1))  # one that ran away counts little
            rows = (weight[:, None, None] * self.by_parameter).reshape(-1, len(std)) * std
            miss = (weight[:, None] * self.error).ravel()
            both = np.vstack([rows, np.eye(len(std))]), np.concatenate([-miss, np.zeros(len(std))])
            delta = std * np.linalg.lstsq(*both, rcond=None)[0]
        return replace(self, error=self.error + self.by_parameter @ delta)


class Mover:
    """Simulates a model through reversals.

    Attributes:
        ready: whether it can: its laws are formulas, since others would take too long; none of its terms has memory
            across a reversal; and the sampling rate is high enough to resolve one.
    """

    def __init__(self, terms: Sequence[Term], period: float) -> None:
        """Take the terms and the time between samples [s]."""
        self._terms, self._period = tuple(terms), period
        self._program = prepared(terms)
        remembers = Balance(terms, np.ones(sum(len(term.columns) for term in terms))).remembers
        self.ready = self._program.step is not None and not remembers and round(TURN.half / period) > 1

    def __reduce__(self) -> tuple[type[Mover], tuple[Sequence[Term], float]]:
        return Mover, (self._terms, self._period)  # a program cannot be pickled

    def missed(self, turns: Turns, theta: Array) -> Missed:
        """Prediction errors of the model with parameters theta (P,) at S reversals, in one simulation.

        The part due to the initial state is projected out; the smoothed state is accurate enough for linearisation.
        """
        count, size = len(turns.time), len(theta)
        push = np.maximum(np.sqrt(np.mean(turns.torque**2, axis=0)), TURN.smallest)  # (S,)
        perturbation = np.concatenate([PERTURBATION, TURN.difference * np.maximum(np.abs(theta), TURN.smallest)])
        perturbations = np.column_stack([np.zeros(2 + size), np.diag(perturbation), np.zeros(2 + size)])  # (2 + P, V)
        state = np.array([turns.position[0], turns.velocity])  # (2, S)
        start = (state[:, None] + perturbations[:2, :, None]).reshape(2, -1)  # (2, V S)
        torque = np.repeat(turns.torque[:, None], size + 4, axis=1)
        torque[:, -1] += TURN.difference * push
        path = simulate(
            self._terms,
            np.repeat(theta[:, None] + perturbations[2:], count, axis=1),
            self._period,
            torque.reshape(len(torque), -1),
            start[0],
            start[1],
            np.tile(turns.time, size + 4),
            before=np.tile(turns.before, size + 4),
            program=self._program,
        ).position.reshape(-1, size + 4, count)
        paths = np.transpose(path, (2, 0, 1))  # (S, N + 1, V)
        steps = np.column_stack([np.tile(perturbation, (count, 1)), TURN.difference * push])
        error = paths[..., :1] - turns.position.T[..., None]
        slopes = (paths[..., 1:] - paths[..., :1]) / steps[:, None]  # by state, parameters and torque
        frames, _ = np.linalg.qr(slopes[..., :2])
        left = np.concatenate([error, slopes[..., 2:]], axis=2)
        left = left - frames @ (np.swapaxes(frames, 1, 2) @ left)
        return Missed(left[..., 0], left[..., 1:-1], left[..., -1])


def mover_of(terms: Sequence[Term], period: float) -> Mover | None:
    """What moves a model through reversals; None of an arm, whose joints move each other, and if it is not ready."""
    if body_of(terms) is not None:
        return None
    mover = Mover(terms, period)
    return mover if mover.ready else None


class TurnFinder:
    """Finds reversals of B pendulums, once the time around them is measured."""

    def __init__(self, batch: int, period: float, delay: int, late: int, slowest: float) -> None:
        """Take B and the time between samples [s], how late velocities and torques come [samples], and the least speed.

        Below the least speed [rad/s], a velocity has no direction.
        """
        self._half, self._delay, self._late, self._slowest = round(TURN.half / period), delay, late, slowest
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
