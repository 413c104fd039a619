"""Draw a new plant for each episode, of one pendulum or of a batch."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from pendulum_env.physics import Model
from pendulum_env.plant import PAPER, refuse_unnamed
from pendulum_env.spaces import merge_seeds


class Spread:
    """Uniform distribution of linear parameters around those of a plant, of given relative widths."""

    def __init__(self, nominal: Model, spread: float | Mapping[str, float]) -> None:
        """Set the nominal plant, and one relative half width for its four base parameters, or widths by name.

        Raises:
            ValueError: if a parameter is unknown, or a width is not from 0 to below 1.
        """
        self.names = [column.name for column in nominal.columns]
        self._nominal = nominal.theta[:, None]
        widths = dict(spread) if isinstance(spread, Mapping) else dict.fromkeys(PAPER, spread)
        for name, width in widths.items():
            if name not in self.names:
                raise ValueError(f"the plant has no parameter '{name}' to draw: it has {', '.join(self.names)}")
            if not 0 <= width < 1:
                raise ValueError(f"the spread of {name} cannot be {width:g}: give a share from 0 to below 1")
        self._widths = self._nominal * [[widths.get(name, 0.0)] for name in self.names]

    def draw(self, rng: np.random.Generator, count: int, options: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Draw parameters of `count` plants by name, (count,) each; `theta` of the reset options takes precedence."""
        drawn = self._nominal + self._widths * rng.uniform(-1.0, 1.0, (len(self.names), count))
        theta = (options or {}).get("theta", {})
        refuse_unnamed(theta)
        return {**dict(zip(self.names, drawn, strict=True)), **theta}


class RandomizePlant(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Draw the parameters of a simulated plant at each reset, around those that it was made with.

    `info["plant"]` holds the drawn parameters.
    """

    def __init__(self, env: gym.Env[Any, Any], spread: float | Mapping[str, float] = 0.3) -> None:
        """Wrap a simulated pendulum.

        Args:
            env: simulated pendulum.
            spread: relative half width of the four base parameters, or of some linear parameters by name.

        Raises:
            ValueError: if the environment is not simulated, or as `Spread`.
        """
        gym.utils.RecordConstructorArgs.__init__(self, spread=spread)
        gym.Wrapper.__init__(self, env)
        plant: Any = env.unwrapped
        if not getattr(plant, "simulated", False):
            raise ValueError("only the plant of a simulated pendulum can be drawn: a recording or a rig is as it is")
        self._spread = Spread(plant.model, spread)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment with a new plant; the same seed draws the same plants."""
        if seed is not None:
            self.np_random = np.random.default_rng([seed, 1])  # independent of the measurement noise
        theta = {name: np.squeeze(values) for name, values in self._spread.draw(self.np_random, 1, options).items()}
        return self.env.reset(seed=seed, options={**(options or {}), "theta": theta})


class RandomizePlantVector(VectorWrapper):
    """`RandomizePlant` for batched pendulums."""

    def __init__(self, env: VectorEnv[Any, Any, Any], spread: float | Mapping[str, float] = 0.3) -> None:
        """Wrap batched pendulums; see `RandomizePlant` for the spread.

        Raises:
            ValueError: if the environments are not batched pendulums, or as `Spread`.
        """
        super().__init__(env)
        plants: Any = env.unwrapped
        if getattr(plants, "set_parameters", None) is None:
            raise ValueError("only the plants of batched pendulums can be drawn: make them with gymnasium.make_vec")
        self._plants, self._spread, self._rng = plants, Spread(plants.model, spread), np.random.default_rng()

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all pendulums with new plants; the same seed draws the same plants."""
        if (merged := merge_seeds(seed)) is not None:
            self._rng = np.random.default_rng(merged)
        options = {**(options or {}), "theta": self._spread.draw(self._rng, self.num_envs, options)}
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]  # lists are passed on
        self._time = np.asarray(info["time"])
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step; draw a new plant for each pendulum that was reset."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        time = np.asarray(info["time"])
        is_new = time <= self._time
        self._time = time
        if is_new.any():
            self._plants.set_parameters(self._spread.draw(self._rng, self.num_envs), is_new)
            info["plant"] = self._plants.plant.info
        return observation, reward, terminated, truncated, info
