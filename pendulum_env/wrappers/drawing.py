"""Base classes of wrappers that draw parameters of the plant for each episode, of one pendulum or of a batch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from pendulum_env._typing import Array
from pendulum_env.plant import refuse_unnamed
from pendulum_env.spaces import merge_seeds


class Distribution(Protocol):
    """Distribution of parameters of a plant."""

    stream: int  # number of its random stream, which makes it independent of other draws from the same seed

    def draw(self, rng: np.random.Generator, count: int) -> dict[str, Array]:
        """Draw parameters of `count` plants by name, (count,) each."""


def replace_drawn(drawn: Mapping[str, Array], options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return options of a reset with drawn parameters in `theta`; those that are given take precedence."""
    theta = (options or {}).get("theta", {})
    refuse_unnamed(theta)
    return {**(options or {}), "theta": {**drawn, **theta}}


def get_plant(env: gym.Env[Any, Any] | VectorEnv[Any, Any, Any], vector_name: str) -> Any:
    """Return the simulated pendulum within an environment; raises ValueError if there is none."""
    if isinstance(env, VectorEnv):
        raise ValueError(f"this is a vector of environments: wrap it in {vector_name}")
    plant: Any = env.unwrapped
    if not getattr(plant, "simulated", False):
        raise ValueError("only the plant of a simulated pendulum can be drawn: a recording or a rig is as it is")
    return plant


def get_plants(env: VectorEnv[Any, Any, Any]) -> Any:
    """Return the batch of pendulums within a vector environment; raises ValueError if there is none."""
    plants: Any = env.unwrapped
    if getattr(plants, "set_parameters", None) is None:
        raise ValueError("only the plants of batched pendulums can be drawn: make them with gymnasium.make_vec")
    return plants


class DrawingWrapper(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Wrapper that draws parameters of a simulated plant at each reset; `info["plant"]` holds them."""

    def __init__(self, env: gym.Env[Any, Any], distribution: Distribution, **arguments: Any) -> None:
        """Wrap a simulated pendulum; the arguments are those of the constructor, which rebuild the wrapper."""
        gym.utils.RecordConstructorArgs.__init__(self, **arguments)
        gym.Wrapper.__init__(self, env)
        self._distribution, self._rng = distribution, np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment with new parameters; the same seed draws the same parameters."""
        if seed is not None:
            self._rng = np.random.default_rng([seed, self._distribution.stream])
        drawn = {name: np.squeeze(values) for name, values in self._distribution.draw(self._rng, 1).items()}
        return self.env.reset(seed=seed, options=replace_drawn(drawn, options))


class DrawingVectorWrapper(VectorWrapper):
    """`DrawingWrapper` for batched pendulums, each with new parameters in every episode of its own."""

    def __init__(self, env: VectorEnv[Any, Any, Any], distribution: Distribution) -> None:
        """Wrap batched pendulums."""
        super().__init__(env)
        self._plants, self._distribution, self._rng = get_plants(env), distribution, np.random.default_rng()

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all pendulums with new parameters; the same seed draws the same parameters."""
        if (merged := merge_seeds(seed, self.num_envs)) is not None:
            self._rng = np.random.default_rng([merged, self._distribution.stream])
        drawn = self._distribution.draw(self._rng, self.num_envs)
        observation, info = self.env.reset(seed=seed, options=replace_drawn(drawn, options))  # type: ignore[arg-type]  # lists are passed on
        self._time = np.asarray(info["time"])
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step; draw new parameters of each pendulum that was reset."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        time = np.asarray(info["time"])
        is_new = time <= self._time
        self._time = time
        if is_new.any():
            self._plants.set_parameters(self._distribution.draw(self._rng, self.num_envs), is_new)
            info["plant"] = self._plants.plant.info
        return observation, reward, terminated, truncated, info
