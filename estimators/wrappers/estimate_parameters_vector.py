"""Six regressor models for each of many environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from estimators.online import Estimates
from estimators.wrappers.estimate_parameters import tell, told, widened
from estimators.wrappers.options import Names, make, measured
from estimators.wrappers.vector import MeasuringVector
from pendulum_env._typing import Mask
from pendulum_env.physics import Term


class EstimateParametersVector(MeasuringVector):
    """`EstimateParameters` for a vector environment; the entries of `info` have a first axis over its environments.

    A pendulum whose time starts anew has been reset: its estimates start anew with it.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        schemes: Names = "all",
        terms: Sequence[str | Term] | None = None,
        *,
        rate: float | None = None,
        in_observation: bool = False,
        **options: Any,
    ) -> None:
        """Wrap a vector environment; the arguments are those of `EstimateParameters`."""
        super().__init__(env)
        self.estimator = make(env, schemes, terms, rate, env.num_envs, options)
        self._in_observation = in_observation
        if in_observation:
            single = widened(env.single_observation_space, len(self.estimator.schemes) * len(self.estimator.names))
            self.single_observation_space = single
            self.observation_space = batch_space(single, env.num_envs)

    def _add(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        time, position, torque = (np.asarray(series, dtype=float) for series in measured(info))
        ended: Mask | None = info.get("_final_info")
        if ended is None:
            self.estimator.reset(time <= self._time)
            now = self.estimator.take(time, position, torque)
        else:  # within this step, some have ended and begun again: their last sample still counts
            final = info["final_info"]
            last = (np.where(ended, a, b) for a, b in zip(measured(final), (time, position, torque), strict=True))
            then = self.estimator.take(*last)
            tell(final, then, self.estimator, slice(None))
            if self._in_observation:
                info["final_obs"] = self._widen(info["final_obs"], then)
            self.estimator.reset(ended)
            now = self.estimator.after_reset(then, ended)
        self._time = time
        tell(info, now, self.estimator, slice(None))
        return self._widen(observation, now) if self._in_observation else observation, info

    @staticmethod
    def _widen(observation: Any, now: Estimates) -> Any:
        return np.concatenate([observation, told(now)], axis=1, dtype=np.float32)
