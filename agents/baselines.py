"""What a trained policy is compared with: signals drawn in advance, and planning with the current estimates.

All are policies of one interface: observations (B, 20) of `ExcitationDesign` in, shares of the peak torque (B, 1) out.
The multisines were found in advance by CMA-ES, the best of their kind on the average of random plants, by `python -m
benchmarks.multisine`, which takes some minutes and writes them anew; but for "separating", which keeps to the peak and
was found, by version 1.0, to tell seven hidden effects apart.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.observer import CONSTRAINTS, COUNT, EPISODE, NOMINAL, SLOW, TICK, Batch, Constraint, log_det, read
from pendulum_env._typing import Array, Mask
from pendulum_env.excitation import Levels, excitation
from pendulum_env.lookup import find
from pendulum_env.physics import BASE
from pendulum_env.physics.simulation import Trajectory, simulate
from pendulum_env.policy import Policy, State

FOUND = Path(__file__).parent / "policies" / "multisine.json"
FREQUENCIES = 0.2 * np.arange(1, 21)  # [Hz]
SEPARATING = "separating"


class Signals:
    """A signal for every pendulum and episode."""

    def __init__(self, draw: Callable[[], Array]) -> None:
        """Take what draws the torque at each tick (T,) [share of the peak]."""
        self._draw = draw

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Torque of the step (B, 1); the state holds the step and the signals."""
        if state is None or np.all(episode_start):
            state = (0, np.stack([self._draw() for _ in observation]))
        step, shares = state
        return shares[:, step % shares.shape[1], None].astype(np.float32), (step + 1, shares)


def foresee(torque: Array, theta: Array, position: Array, velocity: Array) -> tuple[Array, Mask]:
    """Rows (T, B, C, P) in nominal units that torques (T, B, C) held for a tick would give, and which are fast enough.

    Args:
        torque: of C candidates for each of B plants [N m].
        theta: parameters of the plants (B, P).
        position: where they start (B,) [rad].
        velocity: and how fast they are (B,) [rad/s].
    """
    shape = torque.shape
    each = [np.repeat(values, shape[-1], axis=-1) for values in (theta.T, position, velocity)]
    # of second order, so an action changes little with finer steps
    way = simulate(BASE, each[0], TICK, torque.reshape(len(torque), -1), each[1], each[2], longest_step=5e-3)
    speed = np.abs(way.velocity)
    usable = (speed[1:] >= SLOW) & (speed[:-1] >= SLOW) & (way.velocity[1:] * way.velocity[:-1] > 0)
    return (rows(way, TICK) * NOMINAL).reshape(*shape, -1), usable.reshape(shape)


def rows(way: Trajectory, period: float) -> Array:
    """Torque per unit of inertia, gravity, viscous and dry friction over each period [s] of a motion (T, N, 4)."""
    q, v = way.position, way.velocity
    parts = [np.diff(v, axis=0) / period, np.sin(0.5 * (q[1:] + q[:-1])), np.diff(q, axis=0) / period, np.sign(v[1:])]
    return np.stack(parts, axis=-1)


class LookAhead:
    """Of all sequences of a few torques, plays the first torque of the one that promises to teach most.

    What counts is log det information. The sequences are simulated with the current estimates, all in one batch, and
    decided anew at every step. Under a budget, the levels are shares of the torque that would spend it evenly, and
    torque has a price: log det grows by P / k in step k, for which an even step's energy is paid. With one torque, held
    for one step, it is the greedy choice. Source of the greedy one: Blanke and Lelarge, FLEX, ICML 2023.
    """

    head_start = 50  # steps; before, log det grows as it will

    def __init__(self, constraint: Constraint, torques: int, ticks: int, levels: Sequence[float]) -> None:
        """Take how many torques a sequence has, how long each is held [ticks], and their levels."""
        self.constraint, self.ticks = constraint, ticks
        self._sequences = np.array(list(itertools.product(levels, repeat=torques))).T  # (torques, C)

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Torques (B, 1)."""
        seen = read(observation)
        most = np.full(len(observation), self.constraint.peak)
        if self.constraint.rms is not None:
            pace = np.sqrt(np.maximum(seen.budget_left, 0.0) / np.maximum(seen.time_left, 1e-3))
            most = np.minimum(most, self.constraint.rms * pace)
        torque = self._sequences[:, None] * most[:, None]  # (torques, B, C)
        held = np.repeat(torque, self.ticks, axis=0)  # (ticks, B, C)
        theta = np.maximum(seen.estimates, 0.3) * NOMINAL  # early estimates may be impossible
        rows, usable = foresee(held, theta, seen.position, seen.velocity)
        rows = rows * usable[..., None]
        worth = log_det(seen.information[:, None] + np.einsum("tbci,tbcj->bcij", rows, rows))
        if self.constraint.rms is not None and len(self._sequences) > 1:  # one step never pays at rest
            worth = worth - self._cost(seen.time_left)
        first = torque[0][np.arange(len(worth)), worth.argmax(axis=1)]
        return (first / self.constraint.peak)[:, None].astype(np.float32), state

    def _cost(self, time_left: Array) -> Array:
        """What the energy of the sequences is worth by now (B, C) [nat]."""
        step = self.head_start + (1.0 - time_left) * EPISODE / TICK
        energy = self.ticks * (self._sequences**2).sum(axis=0)  # in that of an even step
        return (COUNT / step)[:, None] * energy


def _drawn(name: str, constraint: Constraint, seed: int) -> Policy:
    """Signals drawn anew for every pendulum and episode, as large as the constraint allows."""
    rng, time = np.random.default_rng(seed), np.linspace(0.0, EPISODE, round(EPISODE / TICK), endpoint=False)

    def draw() -> Array:
        torque = excitation(name, rng, EPISODE, constraint.peak).signal(time)
        if constraint.rms is not None:
            torque = torque * constraint.rms / np.sqrt(np.mean(torque**2))
        return torque / constraint.peak

    return Signals(draw)


def signal(weights: Array, constraint: Constraint) -> Array:
    """Torque at each tick (T, ...) of weights (2 F, ...) of sines and cosines, as large as the constraint allows."""
    phase = 2 * np.pi * TICK * np.outer(np.arange(round(EPISODE / TICK)), FREQUENCIES)
    torque = np.concatenate([np.sin(phase), np.cos(phase)], axis=1) @ weights
    if constraint.rms is None:
        return np.asarray(torque * constraint.peak / np.abs(torque).max(axis=0))
    torque = torque * constraint.rms / np.sqrt((torque**2).mean(axis=0))
    return np.asarray(np.clip(torque, -constraint.peak, constraint.peak))


def separating(amplitude: float | None = None) -> Levels:
    """The multisine that tells hidden effects apart, with that bound of the torque [N m]; over and over."""
    constraint = CONSTRAINTS["peak"] if amplitude is None else Constraint(amplitude)
    torque = signal(shipped(SEPARATING), constraint)
    return Levels(constraint.peak, tuple(TICK * np.arange(1, len(torque) + 1)), tuple(torque))


def shipped(name: str) -> Array:
    """Weights (2 F,) that were found under the constraint of that name, or to tell effects apart."""
    return np.array(json.loads(FOUND.read_text())[name])


def _optimised(constraint: Constraint, _: int) -> Policy:
    """The multisine that was found in advance, the same for all."""
    weights = shipped("peak" if constraint.rms is None else "rms")
    shares = signal(weights, constraint) / constraint.peak
    return Signals(lambda: shares)


def _look_ahead(constraint: Constraint, _: int) -> Policy:  # 0.4 s
    if constraint.rms is None:
        return LookAhead(constraint, 4, 5, (-1.0, 0.0, 1.0))
    return LookAhead(constraint, 3, 7, (-2.0, -1.0, 0.0, 1.0, 2.0))


BASELINE = "two-tone"  # the paper's, of random phases
RANDOM = "random-sinusoid"  # ten sines of random frequencies, 0.2 to 4 Hz, and phases
BASELINES: dict[str, Callable[[Constraint, int], Policy]] = {
    BASELINE: partial(_drawn, "paper"),
    RANDOM: partial(_drawn, "multisine"),
    "multisine-optimised": _optimised,
    "greedy": lambda constraint, _: LookAhead(constraint, 1, 1, (-1.0, -0.5, 0.0, 0.5, 1.0)),
    "look-ahead": _look_ahead,
}


def baseline(name: str, constraint: str, seed: int = 0) -> Policy:
    """Policy by name.

    Raises:
        ValueError: if a name is unknown.
    """
    return find("baseline", name, BASELINES)(find("constraint", constraint, CONSTRAINTS), seed)
