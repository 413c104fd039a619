"""Wrappers that reward the gain of information about the parameters."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from estimators.wrappers.estimate_parameters import EstimateParameters
from pendulum_env._typing import Array

NO_REGRESSOR = (
    "info lacks 'regressor': wrap the environment in EstimateParameters first, as "
    "InformationReward(EstimateParameters(env))"
)


class Information:
    """Information matrices sum phi phi' of B pendulums, with a small prior.

    Source: D-optimality, Fedorov, Theory of Optimal Experiments, 1972.
    """

    def __init__(self, prior: float) -> None:
        """Create the matrices with a prior on the diagonal, which keeps the first log det finite."""
        if not 0 < prior < np.inf:
            raise ValueError(f"prior is {prior:g}: give a small positive number")
        self._prior = prior

    def begin(self, info: dict[str, Any]) -> None:
        """Start with the prior, at the info of a reset."""
        batch, parameters = np.atleast_2d(get_regressor(info)).shape
        self._inverse, self._time = np.tile(np.eye(parameters) / self._prior, (batch, 1, 1)), info["time"]

    def compute_gain(self, info: dict[str, Any]) -> Array:
        """Add the regressors of a step, and return the gain of log det(information) (B,) [nat].

        The information of a pendulum restarts when its time restarts.
        """
        row, time, prior = np.atleast_2d(get_regressor(info)), info["time"], np.eye(len(self._inverse[0])) / self._prior
        is_reset, self._time = np.atleast_1d(info.get("_final_info", time < self._time)), time
        if "final_info" not in info:
            self._inverse[is_reset] = prior
            return self._add_row(row)
        # include the last sample of an episode that ended within this step
        gain = self._add_row(np.where(is_reset[:, None], get_regressor(info["final_info"]), row))
        self._inverse[is_reset] = prior
        return gain

    def _add_row(self, regressor: Array) -> Array:
        """Add a row to the information of each pendulum (B, P), and return its gain (B,) [nat]."""
        weighted = (self._inverse @ regressor[..., None])[..., 0]
        leverage = np.einsum("bi,bi->b", regressor, weighted)  # matrix determinant lemma
        self._inverse -= weighted[:, :, None] * (weighted / (1.0 + leverage)[:, None])[:, None, :]
        return np.log1p(leverage)


class InformationSteps:
    """Reset and step of the wrappers that reward information."""

    env: Any
    _information: Information

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and the information."""
        observation, info = self.env.reset(**kwargs)
        self._information.begin(info)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environment; the reward is the gain by the newest regressor."""
        observation, _, terminated, truncated, info = self.env.step(action)
        gain = self._information.compute_gain(info)
        return observation, gain if isinstance(self, VectorEnv) else float(gain[0]), terminated, truncated, info


class InformationReward(InformationSteps, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Replace the reward by the gain of log det(information) [nat] (D-optimality).

    The information is the sum of the outer products of `info["regressor"]`, which needs an inner `EstimateParameters`.
    """

    def __init__(self, env: gym.Env[Any, Any], prior: float = 1e-6) -> None:
        """Wrap an environment with `regressor` in `info`; see `Information` for the prior."""
        gym.utils.RecordConstructorArgs.__init__(self, prior=prior)
        gym.Wrapper.__init__(self, env)
        self._information = Information(prior)
        while not isinstance(env, EstimateParameters):
            if not isinstance(env, gym.Wrapper):
                raise ValueError(NO_REGRESSOR)
            env = env.env


class InformationRewardVector(InformationSteps, VectorWrapper):
    """`InformationReward` for a vector environment; a reset also resets the information of a pendulum."""

    def __init__(self, env: VectorEnv[Any, Any, Any], prior: float = 1e-6) -> None:
        """Wrap a vector environment with `regressor` (B, P) in `info`."""
        super().__init__(env)
        self._information = Information(prior)


def get_regressor(info: dict[str, Any]) -> Any:
    """Return the regressor of an info; a missing regressor raises a `ValueError`."""
    if "regressor" not in info:
        raise ValueError(NO_REGRESSOR)
    return info["regressor"]
