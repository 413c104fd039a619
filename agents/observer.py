"""What an agent sees of pendulums, and what it may do to them: samples in, observations out, shares made torques.

One definition serves the environment in which policies learn and the rig on which they act.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.knowledge import FEATURES, NOMINAL, SLOW, Knowledge, recall
from pendulum_env._typing import Array
from pendulum_env.interface import MAX_TORQUE, check_positive
from pendulum_env.mistake import Mistake

EPISODE = 10.0  # [s], the usual length of one
TICK = 0.02  # [s], over which a torque is held: decisions at 50 Hz
FAST = 10.0  # [rad/s], by which velocity is divided in the observation
BOUND = 5.0  # of the observation
INPUTS = 3 + FEATURES + 6  # of the observation
ODD = [0, 2, INPUTS - 2, INPUTS - 1]  # places of an observation that change sign in a mirror

Batch = NDArray[np.float32]


@dataclass(frozen=True)
class Constraint:
    """What the torque must keep to.

    Attributes:
        peak: bound of |torque| [N m].
        rms: bound of its root mean square over the episode [N m], enforced as a budget of energy; None for none.
    """

    peak: float
    rms: float | None = None


CONSTRAINTS = {
    "peak": Constraint(6.0),  # what the paper's two tones reach
    "rms": Constraint(MAX_TORQUE, 3.0),  # their root mean square; the drive bounds the peak
}


class Seen(NamedTuple):
    """What an observation says, in SI units but for the shares; arrays (B, ...)."""

    position: Array  # within a turn [rad]
    velocity: Array  # [rad/s]
    information: Array  # (B, P, P) in nominal units
    estimates: Array  # shares of the nominal parameters (B, P)
    time_left: Array  # share
    budget_left: Array  # share; 1 where there is none to keep
    stuck: Array  # 1 where the last tick was slower than what teaches
    strength: Array  # share of the constraint's torque that is allowed
    hurry: Array  # share of the limit on speed, signed; 0 where there is none
    outwards: Array  # share of the way to the limit on turns, signed; 0 where there is none


def read(observation: Array | Batch) -> Seen:
    """Meaning of observations (B, N)."""
    o = np.asarray(observation, dtype=float)
    information, estimates = recall(o[:, 3 : 3 + FEATURES])
    return Seen(np.arctan2(o[:, 0], o[:, 1]), FAST * o[:, 2], information, estimates, *o[:, 3 + FEATURES :].T)


def mirrored(observation: Any) -> tuple[Array, Array]:
    """Observations (B, N) as if the arm turned in the positive direction, and the sign (B,) their torques then need.

    Pendulum and information look the same in a mirror, so nobody has to learn both directions.
    """
    turned = np.array(observation, dtype=float)
    sign = np.where(turned[..., 2] < 0, -1.0, 1.0)
    turned[..., ODD] *= sign[..., None]
    return turned, sign


class Observer:
    """Sees B pendulums from their start on, tick by tick.

    Attributes:
        held: samples in a tick.
        ticks: of an episode.
        tick: that begins now.
        knowledge: what has been learnt.
        strength: share of the constraint's torque that is allowed, scalar or (B,).
        max_speed: [rad/s], scalar or (B,).
        max_angle: to either side [rad], scalar or (B,).
    """

    def __init__(
        self,
        constraint: Constraint,
        seconds: float,
        rate: float,
        max_speed: float | None = None,
        max_turns: float | None = None,
    ) -> None:
        """Take the constraint, the length of an episode [s], the samples per second [Hz], and limits if there are any.

        Raises:
            ValueError: if a limit is not positive.
            Mistake: if the episode is too short, or ticks are not a whole number of samples, two or more.
        """
        limits = {"max_speed": max_speed, "max_turns": max_turns}
        check_positive("a design", **{name: limit for name, limit in limits.items() if limit is not None})
        if not TICK <= seconds < np.inf:
            raise Mistake(f"an episode cannot last {seconds:g} s: give {TICK:g} s or more")
        self.held = round(TICK * rate)
        if self.held < 2 or abs(self.held - TICK * rate) > 1e-6:
            raise Mistake(f"torque is chosen every {TICK:g} s, so {rate:g} Hz will not do: give a multiple of 50 Hz")
        self.constraint, self.rate, self.ticks = constraint, rate, round(seconds / TICK)
        self.strength: float | Array = 1.0
        self.max_speed: float | Array = np.inf if max_speed is None else max_speed
        self.max_angle: float | Array = np.inf if max_turns is None else 2 * np.pi * max_turns

    def start(self, position: Array, velocity: Array) -> None:
        """Begin an episode at positions [rad] and velocities [rad/s] (B,)."""
        batch = len(position)
        self.tick = 0
        self.knowledge = Knowledge.none(batch)
        self._position, self._velocity, self._torque = position, velocity, np.zeros(batch)
        self._stuck = np.ones(batch, dtype=bool)
        rms = np.inf if self.constraint.rms is None else self.constraint.rms
        self._budget = (rms * self.strength) ** 2 * self.ticks * np.ones(batch)  # [(N m)^2 ticks]
        self._left = self._budget

    def allow(self, share: Array) -> Array:
        """Torque (B,) that constraint and limits let act for a tick, of shares of the peak (B,) [N m]."""
        torque = self.constraint.peak * self.strength * np.clip(share, -1.0, 1.0)
        for limited in (self._velocity / self.max_speed, self._position / self.max_angle):
            torque = np.where(limited * np.sign(torque) >= 1.0, 0.0, torque)
        affordable = np.sqrt(np.maximum(self._left, 0.0))
        torque = np.clip(torque, -affordable, affordable)
        self._left = self._left - torque**2
        return torque

    def take(self, positions: Array, torques: Array) -> None:
        """Take in a tick: positions [rad] and torques [N m] as measured after each sample (held, B).

        What it teaches is its balance of impulses. Differences of positions are velocities half a sample earlier, so
        the tick ends, and began, so much earlier.
        """
        way = np.concatenate([self._position[None], positions])
        velocity = np.concatenate([self._velocity[None], self.rate * np.diff(way, axis=0)])
        fast = (np.abs(velocity) >= SLOW).all(axis=0) & (np.ptp(np.sign(velocity), axis=0) == 0)
        rows = [
            (velocity[-1] - velocity[0]) / TICK,
            np.sin(way).mean(axis=0),
            (way[-1] - way[0]) / TICK,
            np.sign(velocity[-1]),
        ]
        mean = torques.mean(axis=0) + 0.5 * (self._torque - torques[-1]) / self.held
        self.knowledge.take(np.stack(rows, axis=1) * NOMINAL, mean, fast)
        self._position, self._velocity, self._torque = positions[-1], velocity[-1], torques[-1]
        self._stuck = (np.abs(velocity) < SLOW).all(axis=0)
        self.tick += 1

    def observe(self) -> Batch:
        """Observations (B, INPUTS)."""
        q, v, every = self._position, self._velocity, np.ones_like(self._position)
        time_left = max(0.0, 1.0 - self.tick / self.ticks) * every
        budget_left = every if self.constraint.rms is None else self._left / self._budget
        limits = self.strength * every, v / self.max_speed, q / self.max_angle
        parts = [np.sin(q), np.cos(q), v / FAST], self.knowledge.features().T
        seen = np.concatenate([*parts, [time_left, budget_left, self._stuck, *limits]])
        return np.clip(seen.T, -BOUND, BOUND).astype(np.float32)
