"""What every task of choosing an excitation is: episodes that last equally long, end together, and pay what they teach.

A pendulum's (`agents.design_env`) and an arm's (`agents.arm_env`) say how episodes begin and what an action does.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agents.observer import BOUND, Batch
from pendulum_env._typing import Array
from pendulum_env.lookup import find

Bools = NDArray[np.bool_]
Seen = tuple[Batch, Array, dict[str, Any]]  # observations (B, N), what is known (B,) [nat], and the info


class TaskVector(VectorEnv[Batch, Batch, Array]):
    """B episodes of a task, with actions in [-1, 1]; the reward is the growth of what is known."""

    options: tuple[str, ...] = ()  # of a reset
    _left = 0  # actions until these episodes end

    def __init__(self, num_envs: int, inputs: int, actions: int, autoreset_mode: AutoresetMode | str) -> None:
        """Take the number of episodes, how many numbers are seen and chosen, and when the next episodes begin."""
        self.num_envs, self.render_mode = num_envs, None
        self.autoreset = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset}
        self.single_observation_space = gym.spaces.Box(-BOUND, BOUND, (inputs,), dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (actions,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @abstractmethod
    def _begin(self, options: dict[str, Any]) -> Seen:
        """Begin episodes of `_left` actions."""

    @abstractmethod
    def _go(self, shares: Array) -> Seen:
        """Act by shares of the largest (B, A)."""

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin episodes; the seed, of a list the first, draws all that is drawn.

        Raises:
            ValueError: if an option is unknown or impossible.
        """
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        for name in options or {}:
            find("option of reset", name, dict.fromkeys(self.options))
        return self._look(self._begin(options or {}))

    def step(  # type: ignore[override]  # Gymnasium types the flags like the rewards
        self, actions: Batch
    ) -> tuple[Batch, Array, Bools, Bools, dict[str, Any]]:
        """Act by shares of the largest torque or speeds (B, A).

        Raises:
            ValueError: if an action is no number, or there is not one for each.
        """
        shares = np.asarray(actions, dtype=float)
        if shares.shape != self.action_space.shape or not np.isfinite(shares).all():
            raise ValueError(f"actions are {self.action_space.shape} numbers, not {actions}")
        nobody = np.zeros(self.num_envs, dtype=bool)
        if self._left <= 0 and self.autoreset is AutoresetMode.NEXT_STEP:
            observation, info = self._look(self._begin({}))
            return observation, np.zeros(self.num_envs), nobody, nobody.copy(), info
        before, self._left = self._known, self._left - 1
        observation, info = self._look(self._go(shares))
        reward = self._known - before
        truncated = np.full(self.num_envs, self._left <= 0)
        if self._left <= 0 and self.autoreset is AutoresetMode.SAME_STEP:
            final = {"final_obs": observation, "_final_obs": truncated, "final_info": info, "_final_info": truncated}
            observation, info = self._look(self._begin({}))
            info |= final
        return observation, reward, nobody, truncated, info

    def _look(self, seen: Seen) -> tuple[Batch, dict[str, Any]]:
        observation, self._known, info = seen
        everyone = np.ones(self.num_envs, dtype=bool)
        return observation, info | {f"_{name}": everyone for name in info}


class Task(gym.Env[Batch, Batch]):
    """One episode of a task: a batch of one, without its first axis; it is truncated in the end, never terminated."""

    def __init__(self, batch: TaskVector) -> None:
        """Take the batch of one."""
        self._batch = batch
        self.observation_space = batch.single_observation_space
        self.action_space = batch.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Batch, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        observation, info = self._batch.reset(seed=seed, options=options)
        self._paid = 0.0
        return observation[0], self._show(info)

    def step(self, action: Batch) -> tuple[Batch, float, bool, bool, dict[str, Any]]:
        """Act by shares of the largest torque or speeds (A,)."""
        observation, reward, _, truncated, info = self._batch.step(np.reshape(action, (1, -1)))
        self._paid += float(reward[0])
        return observation[0], float(reward[0]), False, bool(truncated[0]), self._show(info)

    def _show(self, info: dict[str, Any]) -> dict[str, Any]:
        """Info of the only one of a batch."""
        self._last = _first(info)
        if self.render_mode == "human":
            self.render()
        return self._last


def _first(info: dict[str, Any]) -> dict[str, Any]:
    """Info of the first of a batch, without masks."""
    own = {name: value for name, value in info.items() if not name.startswith("_")}
    return {name: _first(value) if isinstance(value, dict) else value[0] for name, value in own.items()}
