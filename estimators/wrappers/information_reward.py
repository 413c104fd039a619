"""A reward for learning about the plant, of one or of many."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from pendulum_env._typing import Array, Mask


class Information:
    """Information matrices sum phi phi' of B pendulums, from a small prior.

    Source: D-optimality, Fedorov, Theory of Optimal Experiments, 1972.
    """

    def __init__(self, prior: float) -> None:
        """Take the prior on the diagonal [regressor unit squared]: it keeps the first log det finite.

        Raises:
            ValueError: if it is not positive.
        """
        if not 0 < prior < np.inf:
            raise ValueError(f"the prior of the information cannot be {prior:g}: give a small positive number")
        self.prior = prior
        self.inverse = np.zeros((0, 0, 0))  # (B, P, P)

    def begin(self, batch: int, parameters: int) -> None:
        """Take B and the number of parameters; nothing has been learnt."""
        self.inverse = np.tile(np.eye(parameters) / self.prior, (batch, 1, 1))

    def reset(self, which: Mask) -> None:
        """Those of the B start anew."""
        self.inverse[which] = np.eye(self.inverse.shape[-1]) / self.prior

    def gain(self, regressor: Array) -> Array:
        """Growth of log det(information) by one row each, (B, P) to (B,) [nat]."""
        raised = (self.inverse @ regressor[..., None])[..., 0]
        leverage = np.einsum("bi,bi->b", regressor, raised)  # matrix determinant lemma
        self.inverse -= raised[:, :, None] * (raised / (1.0 + leverage)[:, None])[:, None, :]
        return np.log1p(leverage)


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
        self._information.begin(1, len(row_of(info)))
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the environment; the reward is what the newest regressor adds."""
        observation, _, terminated, truncated, info = self.env.step(action)
        gain = float(self._information.gain(row_of(info)[None])[0])
        return observation, gain, terminated, truncated, info


class InformationRewardVector(VectorWrapper):
    """`InformationReward` for a vector environment; a pendulum that was reset has learnt nothing."""

    def __init__(self, env: VectorEnv[Any, Any, Any], prior: float = 1e-6) -> None:
        """Wrap a vector environment whose `info` carries `regressor` (B, P)."""
        super().__init__(env)
        self._information = Information(prior)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments: nothing has been learnt."""
        observation, info = self.env.reset(
            seed=seed,  # type: ignore[arg-type]  # Gymnasium's own wrappers pass lists
            options=options,
        )
        self._information.begin(*row_of(info).shape)
        self._time = np.asarray(info["time"])
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments; the rewards are what the newest regressors add."""
        observation, _, terminated, truncated, info = self.env.step(actions)
        row, time = row_of(info), np.asarray(info["time"])
        anew, self._time = time <= self._time, time
        if "final_info" in info:  # what ended within this step has learnt from its last sample, too
            gain = self._information.gain(np.where(anew[:, None], row_of(info["final_info"]), row))
            self._information.reset(anew)
        else:
            self._information.reset(anew)
            gain = self._information.gain(row)
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
