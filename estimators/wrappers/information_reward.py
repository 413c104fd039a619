"""A reward for learning about the plant."""

from __future__ import annotations

from typing import Any

import gymnasium as gym

from estimators.wrappers.information import Information


class InformationReward(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Pay a step for what it taught: growth of log det(information) [nat] (D-optimality); spaces pass through.

    The information is the sum of the outer products of `info["regressor"]`, which `EstimateParameters` provides: wrap
    the environment in it first.
    """

    def __init__(self, env: gym.Env[Any, Any], prior: float = 1e-6) -> None:
        """Wrap an environment whose `info` carries `regressor`; see `Information` for the prior."""
        gym.utils.RecordConstructorArgs.__init__(self, prior=prior)
        gym.Wrapper.__init__(self, env)
        self._information = Information(prior)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment: nothing has been learnt."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._information.reset(1, len(row_of(info)))
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment; the reward is what the newest regressor adds."""
        observation, _, terminated, truncated, info = self.env.step(action)
        gain = float(self._information.gain(row_of(info)[None])[0])
        return observation, gain, terminated, truncated, info


def row_of(info: dict[str, Any]) -> Any:
    """Regressor in an info.

    Raises:
        ValueError: if there is none.
    """
    if "regressor" not in info:
        raise ValueError(
            "InformationReward needs info['regressor'], which is not there: wrap the environment in EstimateParameters "
            "first, as InformationReward(EstimateParameters(env))"
        )
    return info["regressor"]
