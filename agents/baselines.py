"""Baselines of trained policies: open-loop signals, and planning with the current estimates.

All have one interface: they take observations (B, 20) of `ExcitationDesign` and return shares of the peak torque
(B, 1). `python -m benchmarks.multisine` found the multisines by CMA-ES, as the best on average over random plants.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.observer import (
    CONSTRAINTS,
    EPISODE,
    MIN_SPEED,
    N_PARAMETERS,
    NOMINAL,
    TICK,
    Batch,
    Constraint,
    compute_log_det,
    decode_observation,
)
from pendulum_env._typing import Array, Mask
from pendulum_env.excitation import excitation
from pendulum_env.lookup import find
from pendulum_env.physics import BASE, Trajectory, simulate
from pendulum_env.policy import Policy, State

WEIGHTS_FILE = Path(__file__).parent / "policies" / "multisine.json"
FREQUENCIES = 0.2 * np.arange(1, 21)  # [Hz]


class SignalPolicy:
    """Policy that plays one open-loop signal per pendulum and episode."""

    def __init__(self, draw: Callable[[], Array]) -> None:
        """Create the policy from a function that returns the torque at each tick (T,) [share of the peak]."""
        self._draw = draw

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Return the torque of the step (B, 1); the state holds the step and the signals."""
        if state is None or np.all(episode_start):
            state = (0, np.stack([self._draw() for _ in observation]))
        step, shares = state
        return shares[:, step % shares.shape[1], None].astype(np.float32), (step + 1, shares)


def predict_rows(torque: Array, theta: Array, position: Array, velocity: Array) -> tuple[Array, Mask]:
    """Predict the rows of candidate torques, each held for a tick.

    Args:
        torque: of C candidates for each of B plants (T, B, C) [N m].
        theta: parameters of the plants (B, P).
        position: at the start (B,) [rad].
        velocity: at the start (B,) [rad/s].

    Returns:
        Rows (T, B, C, P) in nominal units, and a mask (T, B, C) of those above `MIN_SPEED`.
    """
    shape = torque.shape
    repeated = [np.repeat(values, shape[-1], axis=-1) for values in (theta.T, position, velocity)]
    # of second order, so an action changes little with finer steps
    motion = simulate(
        BASE, repeated[0], TICK, torque.reshape(len(torque), -1), repeated[1], repeated[2], longest_step=5e-3
    )
    speed = np.abs(motion.velocity)
    usable = (speed[1:] >= MIN_SPEED) & (speed[:-1] >= MIN_SPEED) & (motion.velocity[1:] * motion.velocity[:-1] > 0)
    return (compute_regressor_rows(motion, TICK) * NOMINAL).reshape(*shape, -1), usable.reshape(shape)


def compute_regressor_rows(motion: Trajectory, period: float) -> Array:
    """Compute the torque per unit of inertia, gravity, viscous and dry friction over each period [s] (T, N, 4)."""
    q, v = motion.position, motion.velocity
    parts = [np.diff(v, axis=0) / period, np.sin(0.5 * (q[1:] + q[:-1])), np.diff(q, axis=0) / period, np.sign(v[1:])]
    return np.stack(parts, axis=-1)


class LookAhead:
    """Policy that plays the first torque of the sequence with the largest predicted log det information.

    All sequences of a few torques are simulated in one batch with the current estimates, at every step. With a torque
    budget, the levels are shares of the torque that spends the budget evenly. Torque then has a price: log det grows by
    P / k in step k, at the cost of the energy of an even step. With one torque, held for one step, the choice is greedy
    (Blanke and Lelarge, FLEX, ICML 2023).
    """

    head_start = 50  # steps added to k, so that early torque is cheap

    def __init__(self, constraint: Constraint, torques: int, ticks: int, levels: Sequence[float]) -> None:
        """Create the policy of sequences of torques, each held for some ticks, at shares of the largest."""
        self.constraint, self.ticks = constraint, ticks
        self._sequences = np.array(list(itertools.product(levels, repeat=torques))).T  # (torques, C)

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Return torques (B, 1)."""
        state_seen = decode_observation(observation)
        bound = np.full(len(observation), self.constraint.peak)
        if self.constraint.rms is not None:
            pace = np.sqrt(np.maximum(state_seen.budget_left, 0.0) / np.maximum(state_seen.time_left, 1e-3))
            bound = np.minimum(bound, self.constraint.rms * pace)
        torque = self._sequences[:, None] * bound[:, None]  # (torques, B, C)
        held_torque = np.repeat(torque, self.ticks, axis=0)  # (ticks, B, C)
        theta = np.maximum(state_seen.estimates, 0.3) * NOMINAL  # early estimates may be unphysical
        rows, usable = predict_rows(held_torque, theta, state_seen.position, state_seen.velocity)
        rows = rows * usable[..., None]
        worth = compute_log_det(state_seen.information[:, None] + np.einsum("tbci,tbcj->bcij", rows, rows))
        if self.constraint.rms is not None and len(self._sequences) > 1:  # at rest, one step is never worth its price
            worth = worth - self._compute_cost(state_seen.time_left)
        first = torque[0][np.arange(len(worth)), worth.argmax(axis=1)]
        return (first / self.constraint.peak)[:, None].astype(np.float32), state

    def _compute_cost(self, time_left: Array) -> Array:
        """Compute the price of the energy of each sequence (B, C) [nat]."""
        step = self.head_start + (1.0 - time_left) * EPISODE / TICK
        energy = self.ticks * (self._sequences**2).sum(axis=0)  # relative to an even step
        return (N_PARAMETERS / step)[:, None] * energy


def _make_random_signals(name: str, constraint: Constraint, seed: int) -> Policy:
    """Make a policy of random signals, scaled to the constraint."""
    rng, time = np.random.default_rng(seed), np.linspace(0.0, EPISODE, round(EPISODE / TICK), endpoint=False)

    def draw() -> Array:
        torque = excitation(name, rng, EPISODE, constraint.peak).signal(time)
        if constraint.rms is not None:
            torque = torque * constraint.rms / np.sqrt(np.mean(torque**2))
        return torque / constraint.peak

    return SignalPolicy(draw)


def make_multisine_torque(weights: Array, constraint: Constraint) -> Array:
    """Compute the torque at each tick (T, ...) of weights (2 F, ...) of sines and cosines, scaled to the constraint."""
    phase = 2 * np.pi * TICK * np.outer(np.arange(round(EPISODE / TICK)), FREQUENCIES)
    torque = np.concatenate([np.sin(phase), np.cos(phase)], axis=1) @ weights
    if constraint.rms is None:
        return np.asarray(torque * constraint.peak / np.abs(torque).max(axis=0))
    torque = torque * constraint.rms / np.sqrt((torque**2).mean(axis=0))
    return np.asarray(np.clip(torque, -constraint.peak, constraint.peak))


def load_weights(name: str) -> Array:
    """Load the weights (2 F,) that were optimised for a constraint."""
    return np.array(json.loads(WEIGHTS_FILE.read_text())[name])


def _make_optimised_multisine(constraint: Constraint, _: int) -> Policy:
    """Make a policy of the optimised multisine, the same for all pendulums."""
    weights = load_weights("peak" if constraint.rms is None else "rms")
    shares = make_multisine_torque(weights, constraint) / constraint.peak
    return SignalPolicy(lambda: shares)


def _make_look_ahead(constraint: Constraint, _: int) -> Policy:  # 0.4 s
    if constraint.rms is None:
        return LookAhead(constraint, 4, 5, (-1.0, 0.0, 1.0))
    return LookAhead(constraint, 3, 7, (-2.0, -1.0, 0.0, 1.0, 2.0))


BASELINE = "two-tone"  # of the paper, with random phases
RANDOM = "random-sinusoid"  # ten sines of random frequencies, 0.2 to 4 Hz, and phases
BASELINES: dict[str, Callable[[Constraint, int], Policy]] = {
    BASELINE: partial(_make_random_signals, "paper"),
    RANDOM: partial(_make_random_signals, "multisine"),
    "multisine-optimised": _make_optimised_multisine,
    "greedy": lambda constraint, _: LookAhead(constraint, 1, 1, (-1.0, -0.5, 0.0, 0.5, 1.0)),
    "look-ahead": _make_look_ahead,
}


def make_baseline(name: str, constraint: str, seed: int = 0) -> Policy:
    """Make a baseline by name; raises ValueError if a name is unknown."""
    return find("baseline", name, BASELINES)(find("constraint", constraint, CONSTRAINTS), seed)
