"""A reward for learning, for each of many environments."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from estimators.wrappers.information import Information
from estimators.wrappers.information_reward import row_of


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
        self._information.reset(*row_of(info).shape)
        self._time = np.asarray(info["time"])
        return observation, info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments; the rewards are what the newest regressors add."""
        observation, _, terminated, truncated, info = self.env.step(actions)
        row, time = row_of(info), np.asarray(info["time"])
        anew = time <= self._time
        self._time = time
        if anew.any():
            self._information.reset(len(row), row.shape[1], anew)
        return observation, self._information.gain(row), terminated, truncated, info
