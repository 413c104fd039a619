"""The design environment as it is learnt on: rewards by final worth, torque at a price, seen forwards, in levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers.vector import TransformAction

from agents.observer import Constraint, mirrored

SCALE = 100.0  # decisions; keeps rewards as large as they were


class Forwards(VectorWrapper):
    """Observations and torques as if the arm turned forwards, as a `Network` sees them."""

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset, and see it forwards."""
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # lists are passed on
        return self._see(observation), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Play shares (B, 1)."""
        torque = self._sign[:, None] * np.asarray(actions)
        observation, reward, terminated, truncated, info = self.env.step(torque)
        if "final_obs" in info:
            info["final_obs"] = mirrored(info["final_obs"])[0].astype(np.float32)
        return self._see(observation), reward, terminated, truncated, info

    def _see(self, observation: Any) -> Any:
        turned, self._sign = mirrored(observation)
        return turned.astype(np.float32)


def in_levels(env: VectorEnv[Any, Any, Any], levels: Sequence[float]) -> VectorEnv[Any, Any, Any]:
    """Torque in levels instead of a share."""
    space, shares = gym.spaces.Discrete(len(levels)), np.array(levels)
    return TransformAction(env, lambda chosen: shares[chosen][:, None], batch_space(space, env.num_envs), space)


class FinalWorth(VectorWrapper):
    """Rewards that grow with t: as log det grows like log t, a row is then worth what it adds to log det in the end."""

    def __init__(self, env: VectorEnv[Any, Any, Any], head_start: int) -> None:
        """Take the environment, and what is added to t [decisions]."""
        super().__init__(env)
        self._head_start, self._tick = head_start, 0

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, and weigh the reward."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        reward = reward * (self._head_start + self._tick) / SCALE
        self._tick = 0 if truncated.all() else self._tick + 1
        return observation, reward, terminated, truncated, info


class PriceTorque(VectorWrapper):
    """A price on the square of the commanded torque, that rises until the mean command keeps the budget.

    The environment enforces the budget anyway, but an agent that spends it at once learns little of what came later.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], constraint: Constraint, rate: float) -> None:
        """Take the environment, its constraint, and by how much the price follows a relative excess, per decision."""
        super().__init__(env)
        assert constraint.rms is not None, "only a budget needs a price"
        self._scale, self._rate = constraint.peak / constraint.rms, rate
        self.price = 0.0  # [nat], of a torque of the budget's size over a decision

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step, charge for the command, and adjust the price."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        excess = (self._scale * np.asarray(actions)[:, 0]) ** 2 - 1.0
        reward = reward - self.price * excess
        self.price = max(0.0, self.price + self._rate * float(excess.mean()))
        return observation, reward, terminated, truncated, info
