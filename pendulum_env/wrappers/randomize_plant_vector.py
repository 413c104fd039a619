"""A new plant for every episode of each of many pendulums."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from pendulum_env.vector_env import DirectDrivePendulumVector
from pendulum_env.wrappers.spread import Spread


class RandomizePlantVector(VectorWrapper):
    """`RandomizePlant` for the batched pendulums; `info["plant"]` holds the linear parameters (B, P)."""

    def __init__(self, env: VectorEnv[Any, Any, Any], spread: float | Mapping[str, float] | str = 0.3) -> None:
        """Wrap batched pendulums; see `RandomizePlant` for the spread."""
        super().__init__(env)
        plants = env.unwrapped
        if not isinstance(plants, DirectDrivePendulumVector):
            raise ValueError("only the plants of batched pendulums can be drawn: make them with gymnasium.make_vec")
        self._plants, self._spread = plants, Spread(plants.model, spread)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all pendulums with new plants; the same seed draws the same plants."""
        first = seed[0] if isinstance(seed, list) else seed
        if first is not None:
            self._rng = np.random.default_rng(first)
        elif not hasattr(self, "_rng"):
            self._rng = np.random.default_rng()
        theta = self._spread.draw(self._rng, self.num_envs)
        observation, info = self.env.reset(
            seed=seed,  # type: ignore[arg-type]  # Gymnasium's own wrappers pass lists
            options={**(options or {}), "theta": theta},
        )
        self._time = np.asarray(info["time"])
        info["plant"] = theta.T
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step; a pendulum that has just been reset gets a new plant."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        time = np.asarray(info["time"])
        anew = time <= self._time
        self._time = time
        if anew.any():
            theta = self._plants.theta.copy()
            theta[:, anew] = self._spread.draw(self._rng, int(anew.sum()))
            self._plants.set_theta(theta)
        info["plant"] = self._plants.theta.T
        return observation, reward, terminated, truncated, info
