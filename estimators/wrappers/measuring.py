"""What the wrappers that learn from the measurement in `info` have in common, of one pendulum or of B."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from estimators.online.clock import Clock
from pendulum_env._typing import Array, Mask


class Learner(Protocol):
    """What takes in a sample of each of B plants: an estimator or a diagnoser."""

    rate: float  # [Hz]

    def reset(self, which: Mask | None = None) -> None:
        """Those pendulums (B,) start anew with the next sample; all without an argument."""

    def take(self, time: Array, position: Array, torque: Array) -> Any:
        """Take in a sample (B,), of an arm its positions and torques (B, n); returns what is known then."""


def measured(info: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Time, position and torque of a sample.

    Raises:
        ValueError: if the environment does not measure.
    """
    try:
        return info["time"], info["position"], info["torque"]
    except KeyError as error:
        raise ValueError(
            f"info lacks {error}: the wrapped environment has to carry time, position and torque"
        ) from None


def repeated(value: object, count: int) -> NDArray[np.object_]:
    """An object once for each of so many environments (B,), as Gymnasium's vector environments hold it."""
    array = np.empty(count, dtype=object)
    array.fill(value)
    return array


class Measuring(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper whose learner takes in the measurement of every reset and every step."""

    def __init__(self, env: gym.Env[Any, Any], learner: Learner, **arguments: Any) -> None:
        """Wrap an environment; the arguments are those that build the wrapper again."""
        gym.utils.RecordConstructorArgs.__init__(self, **arguments)
        gym.Wrapper.__init__(self, env)
        self._learner, self._clock = learner, Clock(learner.rate)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and begin anew."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._learner.reset()
        self._clock.restart()
        return self._take(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and take in its measurement."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._take(observation, info), reward, terminated, truncated, info

    def _take(self, observation: Any, info: dict[str, Any]) -> Any:
        if "fault" not in info:  # with one, nothing was measured
            sample = measured(info)
            self._clock.tick(sample[0])
            self._known = self._learner.take(*(np.array(part, dtype=float)[None] for part in sample))
        return self._write_info(observation, info)

    @abstractmethod
    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        """Put what is known into an info, and return the observation."""


class MeasuringVector(VectorWrapper):
    """`Measuring` for a vector environment: a pendulum whose time starts anew has been reset."""

    def __init__(self, env: VectorEnv[Any, Any, Any], learner: Learner) -> None:
        """Wrap a vector environment."""
        super().__init__(env)
        self._learner = learner

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments and begin anew."""
        observation, info = self.env.reset(
            seed=seed,  # type: ignore[arg-type]  # Gymnasium's own wrappers pass lists
            options=options,
        )
        self._time = np.full(self.num_envs, np.inf)  # of the last sample [s]
        return self._take(observation, info), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments and take in their measurements."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        return self._take(observation, info), reward, terminated, truncated, info

    def _take(self, observation: Any, info: dict[str, Any]) -> Any:
        ended: Mask | None = info.get("_final_info")
        if ended is not None:  # within this step, some have ended and begun again: their last sample still counts
            final, self._time = info["final_info"], np.asarray(info["time"])
            last = [np.where(ended, a, b) for a, b in zip(measured(final), measured(info), strict=True)]
            self._known = self._learner.take(*last)
            info["final_obs"] = self._write_info(info["final_obs"], final)
            self._restart(ended, last[0])
            return self._write_info(observation, info)
        sample = [np.array(values, dtype=float) for values in measured(info)]
        for name, values in zip(("_time", "_position", "_torque"), sample, strict=True):
            values[~np.broadcast_to(info.get(name, True), values.shape)] = np.nan  # not measured, by Gymnasium's masks
        self._learner.reset(sample[0] <= self._time)
        self._time = np.where(np.isfinite(sample[0]), sample[0], self._time)
        self._known = self._learner.take(*sample)
        return self._write_info(observation, info)

    def _restart(self, ended: Mask, time: Array) -> None:
        """Begin anew with those pendulums (B,), whose last sample is of a time (B,) [s]."""
        self._learner.reset(ended)

    @abstractmethod
    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        """Put what is known into an info, and return the observation."""
