"""A new plant for every episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from pendulum_env.env import DirectDrivePendulum
from pendulum_env.wrappers.spread import Spread


class RandomizePlant(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Draw the parameters of a simulated plant anew at every reset, around those it was made with.

    `info["plant"]` of the reset holds them, by name.
    """

    def __init__(self, env: gym.Env[Any, Any], spread: float | Mapping[str, float] | str = 0.3) -> None:
        """Wrap a simulated pendulum.

        Args:
            env: the environment.
            spread: relative half width of the four base parameters, or of some linear parameters by name; "covariance"
                draws all linear parameters as an identified model knows them (shape parameters stay as they are).

        Raises:
            ValueError: if the environment's plant cannot be drawn, or see `Spread`.
        """
        gym.utils.RecordConstructorArgs.__init__(self, spread=spread)
        gym.Wrapper.__init__(self, env)
        plant = env.unwrapped
        if not isinstance(plant, DirectDrivePendulum) or not plant.simulated:
            raise ValueError("only the plant of a simulated pendulum can be drawn: a recording or a rig is as it is")
        self._spread = Spread(plant.model, spread)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment with a new plant; the same seed draws the same plants."""
        if seed is not None:
            self.np_random = np.random.default_rng([seed, 1])  # not the numbers that the measurement's noise draws
        theta = self._spread.draw(self.np_random, 1)[:, 0]
        plant = dict(zip(self._spread.names, theta.tolist(), strict=True))
        observation, info = self.env.reset(seed=seed, options={"theta": plant, **(options or {})})
        info["plant"] = plant
        return observation, info
