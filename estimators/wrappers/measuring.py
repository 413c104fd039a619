"""Base classes of wrappers that pass the measurements in `info` to an online algorithm."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from estimators.online.replay import OnlineAlgorithm
from estimators.online.stream import Clock
from pendulum_env._typing import Array, Mask


def get_measurement(info: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Return time, position and torque of an info; a missing quantity raises a `ValueError`."""
    try:
        return info["time"], info["position"], info["torque"]
    except KeyError as error:
        raise ValueError(f"info lacks {error}: wrap an environment with time, position and torque in info") from None


class MeasurementSteps:
    """Reset and step of wrappers that pass the measurements of B plants to an online algorithm.

    A plant restarts when its time restarts.
    """

    env: Any
    _algorithm: OnlineAlgorithm[Any]
    _time: Any  # of the last samples [s]

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and the algorithm."""
        observation, info = self.env.reset(**kwargs)
        self._time = np.inf  # the next samples restart all plants
        return self._take(observation, info), info

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environment, and pass on its measurement."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._take(observation, info), reward, terminated, truncated, info

    @abstractmethod
    def _take(self, observation: Any, info: dict[str, Any]) -> Any:
        """Pass the measurements of an info on, and write the results into the info; return the observations."""

    @abstractmethod
    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        """Write the result into an info, and return the observation."""


class MeasurementWrapper(MeasurementSteps, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Wrapper that passes the measurement of each reset and step of an environment to an online algorithm."""

    def __init__(self, env: gym.Env[Any, Any], algorithm: OnlineAlgorithm[Any], **arguments: Any) -> None:
        """Wrap an environment; the arguments are those of the constructor, which rebuild the wrapper."""
        gym.utils.RecordConstructorArgs.__init__(self, **arguments)
        gym.Wrapper.__init__(self, env)
        self._algorithm, self._clock = algorithm, Clock(algorithm.rate)

    def _take(self, observation: Any, info: dict[str, Any]) -> Any:
        """Pass a measurement on. A fault has no measurement, and repeats the last result."""
        if "fault" not in info:
            sample = get_measurement(info)
            if sample[0] < self._time:  # an inner wrapper, for example `Autoreset`, may have reset the environment
                self._algorithm.reset()
                self._clock.restart()
            self._time = sample[0]
            self._clock.tick(self._time)
            self._known = self._algorithm.take(*(np.array(part, dtype=float)[None] for part in sample))
        return self._write_info(observation, info)


class MeasurementVectorWrapper(MeasurementSteps, VectorWrapper):
    """`MeasurementWrapper` for a vector environment."""

    def __init__(self, env: VectorEnv[Any, Any, Any], algorithm: OnlineAlgorithm[Any]) -> None:
        """Wrap a vector environment."""
        super().__init__(env)
        self._algorithm = algorithm

    def _take(self, observation: Any, info: dict[str, Any]) -> Any:
        """Pass measurements on.

        If an episode ended within the step, the plant restarts. The last sample of this episode is then passed on, and
        not the first sample of the next.
        """
        ended: Mask | None = info.get("_final_info")
        if ended is not None:  # Gymnasium's SAME_STEP mode
            final, self._time = info["final_info"], np.asarray(info["time"])
            pairs = zip(get_measurement(final), get_measurement(info), strict=True)
            last_sample = [np.where(ended, a, b) for a, b in pairs]
            self._known = self._algorithm.take(*last_sample)
            info["final_obs"] = self._write_info(info["final_obs"], final)
            self._restart(ended, last_sample[0])
            return self._write_info(observation, info)
        sample = [np.array(values, dtype=float) for values in get_measurement(info)]
        for name, values in zip(("_time", "_position", "_torque"), sample, strict=True):
            if name in info:
                values[~info[name]] = np.nan  # masked: not measured
        self._algorithm.reset(sample[0] <= self._time)
        self._time = np.where(np.isfinite(sample[0]), sample[0], self._time)
        self._known = self._algorithm.take(*sample)
        return self._write_info(observation, info)

    def _restart(self, which: Mask, time: Array) -> None:
        """Restart plants (B,); the times are those of their last samples (B,) [s]."""
        self._algorithm.reset(which)
