"""What the wrappers of vector environments that take in measurements have in common."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from estimators.wrappers.options import measured
from pendulum_env._typing import Array, Mask


class MeasuringVector(VectorWrapper):
    """A wrapper that adds something to what every reset and every step of B environments gives."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        """Wrap a vector environment."""
        super().__init__(env)
        self._time = np.full(env.num_envs, np.inf)  # of the last sample [s]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments and begin anew."""
        observation, info = self.env.reset(
            seed=seed,  # type: ignore[arg-type]  # Gymnasium's own wrappers pass lists
            options=options,
        )
        self._time = np.full(self.num_envs, np.inf)
        return self._add(observation, info)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments and take in their measurements."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        observation, info = self._add(observation, info)
        return observation, reward, terminated, truncated, info

    @abstractmethod
    def _add(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        """Take in a sample of each, and add what is told."""

    def _measured(self, info: dict[str, Any]) -> tuple[Mask, tuple[Array, Array, Array]]:
        """Which pendulums (B,) have been reset: their time has not gone on; and time, position and torque, (B,) each.

        Where Gymnasium's masks say that there is no sample, it is not a number.

        Raises:
            ValueError: if the environment does not measure.
        """
        time, position, torque = (np.array(values, dtype=float) for values in measured(info))
        for name, values in (("time", time), ("position", position), ("torque", torque)):
            values[~np.asarray(info.get(f"_{name}", True)) & np.ones(values.shape, dtype=bool)] = np.nan
        anew = np.asarray(time <= self._time)
        self._time = np.where(np.isfinite(time), time, self._time)
        return anew, (time, position, torque)
