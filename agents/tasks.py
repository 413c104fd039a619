"""The design environment as it is learnt on."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorWrapper
from gymnasium.vector.utils import batch_space

from agents.arm_env import ArmExcitationDesignVector
from agents.config import Config
from agents.design_env import ExcitationDesignVector
from agents.observer import mirrored


class LearntOn(VectorWrapper):
    """Torque in levels, seen as if the arm turned forwards, as a `Network` sees it, and paid by its worth in the end.

    Rewards grow with t: as log det grows like log t, a row is then worth what it adds to log det in the end. Under a
    budget of torque, the square of the command has a price, that rises until the mean command keeps the budget: the
    environment enforces it anyway, but an agent that spends it at once learns little of what came later.
    """

    env: ExcitationDesignVector
    scale = 100.0  # decisions; keeps rewards as large as they were

    def __init__(self, env: ExcitationDesignVector, config: Config) -> None:
        """Take the environment; the configuration has levels, head start and the rate of the price."""
        super().__init__(env)
        self._levels, self._head_start, self._tick = np.array(config.levels), config.head_start, 0
        self.single_action_space = gym.spaces.Discrete(len(config.levels))
        self.action_space = batch_space(self.single_action_space, env.num_envs)
        peak, rms = env.constraint.peak, env.constraint.rms
        self._per_rms, self._rate = (0.0, 0.0) if rms is None else (peak / rms, config.price_rate)
        self.price = 0.0  # [nat], of a torque of the budget's size over a decision

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset, and see it forwards."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._see(observation), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play levels (B,), weigh the reward, charge for the command, and adjust the price."""
        share = self._sign * self._levels[actions]
        observation, reward, terminated, truncated, info = self.env.step(share[:, None])
        excess = (self._per_rms * share) ** 2 - 1.0
        reward = reward * (self._head_start + self._tick) / self.scale - self.price * excess
        self._tick = 0 if truncated.all() else self._tick + 1
        self.price = max(0.0, self.price + self._rate * float(excess.mean()))
        if "final_obs" in info:
            info["final_obs"] = mirrored(info["final_obs"])[0].astype(np.float32)
        return self._see(observation), reward, terminated, truncated, info

    def _see(self, observation: Any) -> Any:
        turned, self._sign = mirrored(observation)
        return turned.astype(np.float32)


class InLevels(VectorWrapper):
    """Motions of an arm, the speed of each joint in levels."""

    env: ArmExcitationDesignVector

    def __init__(self, env: ArmExcitationDesignVector, config: Config) -> None:
        """Take the environment; the configuration has the levels."""
        super().__init__(env)
        self._levels = np.array(config.levels)
        self.single_action_space = gym.spaces.MultiDiscrete([len(config.levels)] * len(env.body.joints))
        self.action_space = batch_space(self.single_action_space, env.num_envs)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play levels (B, n)."""
        return self.env.step(self._levels[actions])
