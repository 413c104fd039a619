"""Base classes of the excitation tasks of `agents.design_env` and `robots.arms.design_env`.

All episodes of a batch have the same length and end together. The reward is the gain of information.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agents.observer import OBSERVATION_BOUND, Batch
from pendulum_env._typing import Array
from pendulum_env.lookup import find
from pendulum_env.spaces import merge_seeds

Bools = NDArray[np.bool_]
TaskState = tuple[Batch, Array, dict[str, Any]]  # observations (B, N), information (B,) [nat], info


class TaskVector(VectorEnv[Batch, Batch, Array]):
    """B episodes of a task, with actions in [-1, 1]; the reward is the gain of information."""

    options: tuple[str, ...] = ()  # names of the options of `reset`
    _steps_left = 0  # steps until the end of the episodes

    def __init__(self, num_envs: int, inputs: int, actions: int, autoreset_mode: AutoresetMode | str) -> None:
        """Create the spaces of observations of `inputs` numbers and actions of `actions` numbers."""
        self.num_envs, self.render_mode = num_envs, None
        self.autoreset = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset}
        self.single_observation_space = gym.spaces.Box(
            -OBSERVATION_BOUND, OBSERVATION_BOUND, (inputs,), dtype=np.float32
        )
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (actions,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @abstractmethod
    def _begin_episodes(self, options: dict[str, Any]) -> TaskState:
        """Begin episodes of `_steps_left` steps."""

    @abstractmethod
    def _apply_actions(self, shares: Array) -> TaskState:
        """Apply actions: shares of the largest torque or speeds (B, A)."""

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin episodes; one generator, seeded by all seeds, draws them. Raises ValueError for an unknown option."""
        super().reset(seed=merge_seeds(seed, self.num_envs))
        for name in options or {}:
            find("option of reset", name, dict.fromkeys(self.options))
        return self._unpack_state(self._begin_episodes(options or {}))

    def step(  # type: ignore[override]  # Gymnasium types the flags like the rewards
        self, actions: Batch
    ) -> tuple[Batch, Array, Bools, Bools, dict[str, Any]]:
        """Apply actions (B, A); raises ValueError if their shape is wrong or one of them is not finite."""
        shares = np.asarray(actions, dtype=float)
        if shares.shape != self.action_space.shape or not np.isfinite(shares).all():
            raise ValueError(f"actions are {actions}: give finite numbers of shape {self.action_space.shape}")
        terminated = np.zeros(self.num_envs, dtype=bool)
        if self._steps_left <= 0 and self.autoreset is AutoresetMode.NEXT_STEP:
            observation, info = self._unpack_state(self._begin_episodes({}))
            return observation, np.zeros(self.num_envs), terminated, terminated.copy(), info
        before, self._steps_left = self._information, self._steps_left - 1
        observation, info = self._unpack_state(self._apply_actions(shares))
        reward = self._information - before
        truncated = np.full(self.num_envs, self._steps_left <= 0)
        if self._steps_left <= 0 and self.autoreset is AutoresetMode.SAME_STEP:
            final = {"final_obs": observation, "_final_obs": truncated, "final_info": info, "_final_info": truncated}
            observation, info = self._unpack_state(self._begin_episodes({}))
            info |= final
        return observation, reward, terminated, truncated, info

    def _unpack_state(self, state: TaskState) -> tuple[Batch, dict[str, Any]]:
        observation, self._information, info = state
        mask = np.ones(self.num_envs, dtype=bool)  # Gymnasium's: each environment has the value
        return observation, info | {f"_{name}": mask for name in info}


class Task(gym.Env[Batch, Batch]):
    """One episode of a task; it ends by truncation. A batch of one, without the first axis."""

    def __init__(self, batch: TaskVector) -> None:
        """Create the environment from a batch of one."""
        self._batch = batch
        self.observation_space = batch.single_observation_space
        self.action_space = batch.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Batch, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        observation, info = self._batch.reset(seed=seed, options=options)
        self._episode_reward = 0.0
        return observation[0], self._unbatch_info(info)

    def step(self, action: Batch) -> tuple[Batch, float, bool, bool, dict[str, Any]]:
        """Apply an action: shares of the largest torque or speeds (A,)."""
        observation, reward, _, truncated, info = self._batch.step(np.reshape(action, (1, -1)))
        self._episode_reward += float(reward[0])
        return observation[0], float(reward[0]), False, bool(truncated[0]), self._unbatch_info(info)

    def _unbatch_info(self, info: dict[str, Any]) -> dict[str, Any]:
        """Return the info without the axis of the batch; render in mode human."""
        self._last_info = select_index(info, 0)
        if self.render_mode == "human":
            self.render()
        return self._last_info


def select_index(value: Any, k: int) -> Any:
    """Return the value of environment k in an entry of a batch's `info`, without masks."""
    if isinstance(value, dict):
        return {name: select_index(entry, k) for name, entry in value.items() if not name.startswith("_")}
    return value[k]
