"""Batched pendulums as a vector environment of stable-baselines3."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from agents.task import select_index
from pendulum_env.lookup import find


class BatchedVecEnv(VecEnv):
    """A Gymnasium vector environment as a stable-baselines3 VecEnv, without a loop over its environments.

    The vector environment must reset within the same step (`autoreset_mode="SameStep"`), as a VecEnv does. Infos have
    the last observation of an episode, and the entries that are asked for. At the end of an episode these are of its
    last step.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], info: Sequence[str] = ()) -> None:
        """Wrap a vector environment.

        Args:
            env: vector environment.
            info: names of the entries of `info` to pass on, such as "plant". None by default, since thousands of
                dictionaries per step cost more than the physics.

        Raises:
            ValueError: if its autoreset mode is not `SAME_STEP`.
        """
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"the autoreset mode of the environment is {mode}: stable-baselines3 needs autoreset_mode='SameStep'"
            )
        self.env, self._names = env, (info,) if isinstance(info, str) else tuple(info)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> VecEnvObs:
        """Reset all environments; the seed of `seed` is used once."""
        observation, info = self.env.reset(seed=self._seeds[0])
        for name in self._names:
            find("entry of info", name, info)
        self._reset_seeds()
        self.reset_infos = self._list_infos(info)
        return np.asarray(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions (B, A)."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all environments with the stored actions."""
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        infos = self._list_infos(info)
        for k in np.flatnonzero(terminated | truncated).tolist():
            infos[k] = self._select_info(info["final_info"], k) | {
                "terminal_observation": info["final_obs"][k],
                "TimeLimit.truncated": bool(truncated[k] and not terminated[k]),
            }
        return observation, np.asarray(reward, dtype=np.float32), terminated | truncated, infos

    def _list_infos(self, info: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the entries of each environment that are asked for."""
        if not self._names:
            return [{} for _ in range(self.num_envs)]
        return [self._select_info(info, k) for k in range(self.num_envs)]

    def _select_info(self, info: Mapping[str, Any], k: int) -> dict[str, Any]:
        """Return the entries of environment k that are asked for."""
        return {name: select_index(info[name], k) for name in self._names if name in info}

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each index."""
        return [getattr(self.env, attr_name, None) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector environment for all pendulums."""
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment once, and return its result for each index."""
        answer = getattr(self.env, method_name)(*method_args, **method_kwargs)
        return [answer for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return whether the vector environment has a wrapper, once for each index."""
        layer: Any = self.env
        while layer is not layer.unwrapped and not isinstance(layer, wrapper_class):
            layer = layer.env
        return [isinstance(layer, wrapper_class) for _ in self._get_indices(indices)]
