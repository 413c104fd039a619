"""What a trained policy is compared with: signals drawn in advance, and planning with the current estimates.

All are policies of one interface: observations (B, 20) of `ExcitationDesign` in, shares of the peak torque (B, 1) out.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agents import multisine
from agents.foresight import foresee
from agents.knowledge import COUNT, CRITERIA, NOMINAL
from agents.network import load
from agents.observer import CONSTRAINTS, EPISODE, TICK, Batch, Constraint, read
from agents.structure import DISCRIMINATE, Structure, promised
from pendulum_env._typing import Array
from pendulum_env.excitation import excitation
from pendulum_env.lookup import find
from pendulum_env.policy import Policy, State

HEAD_START = 50  # steps; before, log det grows as it will


class Signals:
    """A signal drawn anew for every pendulum and episode, as large as the constraint allows."""

    def __init__(self, name: str, constraint: Constraint, seed: int, seconds: float = EPISODE) -> None:
        """Take the kind of signal, the constraint, the seed of what is drawn, and the length of an episode [s]."""
        self.name, self.constraint, self.seconds = name, constraint, seconds
        self._rng = np.random.default_rng(seed)

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Torque of the step (B, 1); the state holds the step and the signals."""
        if state is None or np.all(episode_start):
            state = (0, np.stack([self._draw() for _ in observation]))
        step, shares = state
        return shares[:, step % shares.shape[1], None].astype(np.float32), (step + 1, shares)

    def _draw(self) -> Array:
        """Shares of the peak over an episode."""
        time = np.linspace(0.0, self.seconds, round(self.seconds / TICK), endpoint=False)
        torque = excitation(self.name, self._rng, self.seconds, self.constraint.peak).signal(time)
        if self.constraint.rms is not None:
            torque = torque * self.constraint.rms / np.sqrt(np.mean(torque**2))
        return torque / self.constraint.peak


class LookAhead:
    """Of all sequences of a few torques, plays the first torque of the one that promises to teach most.

    What counts is log det information, "D", or the log of the summed relative variance, "A".

    The sequences are simulated with the current estimates, all in one batch, and decided anew at every step. Under a
    budget, the levels are shares of the torque that would spend it evenly, and torque has a price: log det grows by
    P / k in step k, for which an even step's energy is paid. With one torque, held for one step, it is the greedy
    choice. Source of the greedy one: Blanke and Lelarge, FLEX, ICML 2023.
    """

    def __init__(
        self, constraint: Constraint, torques: int, ticks: int, levels: tuple[float, ...], criterion: str = "D"
    ) -> None:
        """Take how many torques a sequence has, how long each is held [ticks], their levels, and what counts."""
        self.constraint, self.ticks, self._worth = constraint, ticks, CRITERIA[criterion]
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
        gained = np.einsum("tbci,tbcj->bcij", rows, rows)
        worth = self._worth(seen.information[:, None] + gained)
        if self.constraint.rms is not None and len(self._sequences) > 1:  # one step never pays at rest
            worth = worth - self._cost(seen.time_left)
        best = worth.argmax(axis=1)
        first = torque[0][np.arange(len(best)), best]
        return (first / self.constraint.peak)[:, None].astype(np.float32), state

    def _cost(self, time_left: Array) -> Array:
        """What the energy of the sequences is worth by now (B, C) [nat]."""
        step = HEAD_START + (1.0 - time_left) * EPISODE / TICK
        energy = self.ticks * (self._sequences**2).sum(axis=0)  # in that of an even step
        return (COUNT / step)[:, None] * energy


class SeparatingLookAhead:
    """As `LookAhead`, for telling structures apart: what counts is `promised`.

    The observation does not hold all that this needs, so it keeps account itself of what it expects to have seen.
    """

    def __init__(self, constraint: Constraint, torques: int, ticks: int, levels: tuple[float, ...]) -> None:
        """Take how many torques a sequence has, how long each is held [ticks], and their levels."""
        most = constraint.peak if constraint.rms is None else constraint.rms
        self._peak, self._ticks, self._structure = constraint.peak, ticks, Structure()
        self._sequences = most * np.array(list(itertools.product(levels, repeat=torques))).T  # (torques, C)

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Torques (B, 1); the state holds the information that is expected by now (B, P, P)."""
        seen, batch = read(observation), len(observation)
        if state is None or np.all(episode_start):
            self._structure.start(batch)
            state = (self._structure.information,)
        torque = np.repeat(self._sequences[:, None], batch, axis=1)  # (torques, B, C)
        held = np.repeat(torque, self._ticks, axis=0)
        theta = np.maximum(seen.estimates, 0.3) * NOMINAL  # early estimates may be impossible
        rows, usable = foresee(held, theta, seen.position, seen.velocity, self._structure)
        rows = rows * usable[..., None]
        worth = promised(state[0][:, None] + np.einsum("tbci,tbcj->bcij", rows, rows, optimize=True))
        best = worth.argmax(axis=1)
        played, row = torque[0][np.arange(batch), best], rows[0][np.arange(batch), best]
        known = state[0] + row[:, :, None] * row[:, None, :]
        return (played / self._peak)[:, None].astype(np.float32), (known,)


class Fixed:
    """One signal for every pendulum and episode, as it was found in advance."""

    def __init__(self, torque: Array, constraint: Constraint) -> None:
        """Take the torque at each tick (T,) [N m]."""
        self._shares = torque / constraint.peak

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Torque of the step (B, 1); the state holds the step."""
        step = 0 if state is None or np.all(episode_start) else state[0]
        share = self._shares[step % len(self._shares)]
        return np.full((len(observation), 1), share, dtype=np.float32), (step + 1,)


@dataclass(frozen=True)
class InTurn:
    """One policy, and after a while another: a verdict that does not come under the one may come under the other.

    Attributes:
        first: that begins.
        then: that goes on, as if an episode began.
        seconds: for which the first one plays.
    """

    first: Policy
    then: Policy
    seconds: float = 3.0

    def predict(
        self, observation: Any, state: State = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Batch, State]:
        """Torques (B, 1); the state holds the step, and the state of the policy whose turn it is."""
        step, own = (0, None) if state is None or np.all(episode_start) else state
        change = round(self.seconds / TICK)
        begins = step in (0, change)
        policy, own = (self.first if step < change else self.then), None if begins else own
        action, own = policy.predict(observation, own, np.full(len(observation), begins), deterministic)
        return action, (step + 1, own)


def agent_in_turn(constraint: str = "peak") -> InTurn:
    """The agent that tells structures apart and, where its verdict does not come, the multisine that does.

    Raises:
        ValueError: if no such agent ships.
    """
    return InTurn(load(f"{DISCRIMINATE}-{constraint}"), _optimised(CONSTRAINTS[constraint], DISCRIMINATE))


def _signal(name: str) -> Callable[[Constraint, int], Policy]:
    return lambda constraint, seed: Signals(name, constraint, seed)


def _greedy(constraint: Constraint, criterion: str) -> Policy:
    return LookAhead(constraint, 1, 1, (-1.0, -0.5, 0.0, 0.5, 1.0), criterion)


def _look_ahead(constraint: Constraint, criterion: str) -> Policy:  # 0.4 s
    if constraint.rms is None:
        return LookAhead(constraint, 4, 5, (-1.0, 0.0, 1.0), criterion)
    return LookAhead(constraint, 3, 7, (-2.0, -1.0, 0.0, 1.0, 2.0), criterion)


def _optimised(constraint: Constraint, criterion: str = "D") -> Policy:
    name = next(name for name, known in CONSTRAINTS.items() if known == constraint)
    return Fixed(multisine.signal(multisine.shipped(name, criterion), constraint), constraint)


def _separating(constraint: Constraint, greedy: bool) -> Policy:
    budget = constraint.rms is not None
    levels = (-2.0, -1.0, 0.0, 1.0, 2.0) if budget else (-1.0, 0.0, 1.0)
    if greedy:
        return SeparatingLookAhead(constraint, 1, 1, levels)
    return SeparatingLookAhead(constraint, 3 if budget else 4, 7 if budget else 5, levels)


BASELINE = "two-tone"  # the paper's
BASELINES: dict[str, Callable[[Constraint, int], Policy]] = {
    BASELINE: _signal("paper"),
    "multisine": _signal("multisine"),
    "multisine-optimised": lambda constraint, _: _optimised(constraint),
    "chirp": _signal("chirp"),
    "prbs": _signal("prbs"),
    "greedy": lambda constraint, _: _greedy(constraint, "D"),
    "greedy-A": lambda constraint, _: _greedy(constraint, "A"),
    "look-ahead": lambda constraint, _: _look_ahead(constraint, "D"),
    "look-ahead-A": lambda constraint, _: _look_ahead(constraint, "A"),
}

SEPARATING: dict[str, Callable[[Constraint, int], Policy]] = {  # those that a verdict on the structure is sooner with
    **{name: BASELINES[name] for name in (BASELINE, "multisine", "multisine-optimised", "chirp", "prbs")},
    "multisine-separating": lambda constraint, _: _optimised(constraint, DISCRIMINATE),
    "greedy": lambda constraint, _: _separating(constraint, greedy=True),
    "look-ahead": lambda constraint, _: _separating(constraint, greedy=False),
}


def baseline(name: str, constraint: str, seed: int = 0) -> Policy:
    """Policy by name.

    Raises:
        ValueError: if a name is unknown.
    """
    return find("baseline", name, BASELINES)(find("constraint", constraint, CONSTRAINTS), seed)
