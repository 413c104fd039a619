"""How soon an excitation lets what is hidden be named: the online diagnosis beside every policy, on the same plants.

What counts is the verdict of `estimators.online.Diagnosers`, with all effects of the library, on what is measured at
1 kHz; not what the policy was paid for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agents.design_env import RATE, ExcitationDesignVector
from agents.evaluation import FRESH
from estimators.online import Diagnosers, OnlineDiagnosis
from pendulum_env._typing import Array
from pendulum_env.policy import Policy, State

LONGEST = 20.0  # [s] of a run
MOMENTS = (5.0, 10.0, 20.0)  # [s] at which verdicts are counted
STANDS = 2.0  # [s], after which a verdict that has not changed stands


@dataclass(frozen=True, eq=False)
class Verdicts:
    """When the right verdict came, on N plants.

    Attributes:
        time: from which on it stood (N,) [s]; inf if it did not.
        group: how many effects it named (N,); 0 without one.
        hidden: ids of what is hidden (N,).
        rms: of the torque until the verdict, or to the end (N,) [N m].
    """

    time: Array
    group: Array
    hidden: tuple[str, ...]
    rms: Array

    @property
    def shares(self) -> list[float]:
        """Of plants with the right verdict, at `MOMENTS`."""
        return [float(np.mean(self.time <= moment)) for moment in MOMENTS]

    @staticmethod
    def join(parts: Sequence[Verdicts]) -> Verdicts:
        """Verdicts on several lots of plants, as one."""
        arrays = [np.concatenate([getattr(part, name) for part in parts]) for name in ("time", "group", "rms")]
        return Verdicts(arrays[0], arrays[1], tuple(id for part in parts for id in part.hidden), arrays[2])


class Leader:
    """Whether a verdict stands: what is missing has been the same group's leader for `STANDS` seconds."""

    def __init__(self) -> None:
        """Nothing is said yet."""
        self.since = np.inf
        self._said: OnlineDiagnosis | None = None

    def take(self, time: float, said: OnlineDiagnosis) -> bool:
        """Take in what is said at a time [s]; whether it stands."""
        same = self._said is not None and said.group[:1] == self._said.group[:1]
        self._said = said
        if said.kind != "missing":
            self.since = np.inf
        elif not same or not np.isfinite(self.since):
            self.since = time
        return bool(time - self.since >= STANDS)


def judge(
    policy: Policy,
    constraint: str,
    effects: Sequence[str],
    plants: int,
    *,
    seed: int = 0,
    tell: Callable[[float], None] | None = None,
) -> Verdicts:
    """Let a policy excite fresh plants, each with one of some effects hidden, until the right verdict stands.

    The same seed gives the same plants and the same noise to every policy. The right verdict is a group with what is
    hidden in it.
    """
    env = ExcitationDesignVector(
        plants, constraint=constraint, criterion="discriminate", effects=effects, seconds=LONGEST
    )
    diagnosers = Diagnosers(RATE, plants)
    observation, info = env.reset(seed=FRESH + seed)
    ids = [effect.partition(":")[0].partition("=")[0] for effect in effects]
    hidden = tuple(ids[k] for k in env.hidden)
    diagnosers.take(np.zeros(plants), info["positions"][:, 0], np.zeros(plants))
    steps, held = env.steps_per_episode, env.observer.held
    since, spent = np.full(plants, np.inf), np.zeros(plants)
    stood, ticks = np.zeros(plants, dtype=bool), np.zeros(plants)
    state: State = None
    for k in range(steps):
        action, state = policy.predict(observation, state, np.full(plants, k == 0), deterministic=True)
        observation, _, _, _, info = env.step(action)
        for j in range(held):
            now = np.where(stood, np.nan, (k * held + j + 1) / RATE)
            diagnosers.take(now, info["positions"][:, j], info["torques"][:, j])
        spent, ticks = spent + ~stood * info["torque"] ** 2, ticks + ~stood
        time = (k + 1) * held / RATE
        right = np.array(
            [said.kind == "missing" and id in said.group for said, id in zip(diagnosers.said, hidden, strict=True)]
        )
        since = np.where(right, np.minimum(since, time), np.inf)
        stood = right & (time - since >= STANDS)
        if tell is not None:
            tell((k + 1) / steps)
        if stood.all():
            break
    group = np.array([len(said.group) for said in diagnosers.said])
    return Verdicts(np.where(stood, since, np.inf), group, hidden, np.sqrt(spent / ticks))
