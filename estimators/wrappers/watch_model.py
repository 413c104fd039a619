"""A wrapper that tells whether the model still predicts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from estimators.arguments import chosen_terms
from estimators.online.watch import Watch
from estimators.wrappers.options import AnyEnv, SampleClock, rate_of, smoothing_of
from estimators.wrappers.vector import MeasuringVector
from pendulum_env.physics import Model, Term


class WatchModel(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Tell online whether the model still predicts, from the measurement in `info`.

    Adds `watch` to `info`, an `estimators.online.Verdict`: its `kind` is "calibrating", then "predicts" until an alarm,
    then "changed" while it is not clear how, then "value" (a parameter changed: `parameter`, `changes`, `since`) or
    "structure" (no value explains it: `where`). A changed value becomes the model's after ten seconds of motion; of a
    wrong structure, nothing more is learnt until `accept()` or a reset.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import WatchModel
        >>> env = WatchModel(gym.make("pendulum_env/DirectDrivePendulum-v0"), alarms_per_hour=0.1)
        >>> _, info = env.reset(seed=0)
        >>> info["watch"].kind
        'calibrating'
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        model: Model | str | Path | None = None,
        *,
        terms: Sequence[str | Term] | None = None,
        rate: float | None = None,
        alarms_per_hour: float = 1.0,
        calibrate: float = 5.0,
    ) -> None:
        """Wrap an environment whose `info` carries `time`, `position` and `torque`.

        Args:
            env: the environment.
            model: an identified model that is watched, or its file; None learns its parameters while it calibrates.
            terms: of the model, by id or as they are, where none is given; None are the paper's four.
            rate: samples per second [Hz]; None asks the environment, as for its encoder, whose steps are smoothed.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.
            calibrate: time of motion in which the model, or at least the size of its errors, is learnt [s].

        Raises:
            ValueError: if a name is unknown, a number is out of its range, both model and terms are given, or a file
                holds no model; when running, if samples do not come at the rate.
        """
        options: dict[str, Any] = {"alarms_per_hour": alarms_per_hour, "calibrate": calibrate}
        gym.utils.RecordConstructorArgs.__init__(self, model=model, terms=terms, rate=rate, **options)
        gym.Wrapper.__init__(self, env)
        self.watch = watch_of(env, model, terms, rate, 1, options)
        self._clock = SampleClock(self.watch.rate)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and begin to calibrate."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.watch.reset()
        self._clock.restart()
        return observation, self._add(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and compare its measurement with the prediction."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, self._add(info)

    def accept(self) -> None:
        """The plant is now as it shall be: calibrate anew."""
        self.watch.accept()

    def _add(self, info: dict[str, Any]) -> dict[str, Any]:
        if "fault" not in info:  # with one, nothing was measured
            time, position, torque = self._clock.measured(info)
            self.watch.take(np.array([time]), np.array([position]), np.array([torque]))
        info["watch"] = self.watch.verdicts[0]
        return info


class WatchModelVector(MeasuringVector):
    """`WatchModel` for a vector environment: `info` has a verdict for each; a reset pendulum starts anew."""

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        model: Model | str | Path | None = None,
        *,
        terms: Sequence[str | Term] | None = None,
        rate: float | None = None,
        alarms_per_hour: float = 1.0,
        calibrate: float = 5.0,
    ) -> None:
        """Wrap a vector environment; the arguments are those of `WatchModel`."""
        super().__init__(env)
        options = {"alarms_per_hour": alarms_per_hour, "calibrate": calibrate}
        self.watch = watch_of(env, model, terms, rate, env.num_envs, options)

    def _add(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        anew, sample = self._measured(info)
        self.watch.reset(anew)
        info["watch"] = tuple(self.watch.take(*sample))
        info["_watch"] = np.ones(self.num_envs, dtype=bool)
        return observation, info


def watch_of(
    env: AnyEnv,
    model: Model | str | Path | None,
    terms: Sequence[str | Term] | None,
    rate: float | None,
    batch: int,
    options: dict[str, Any],
) -> Watch:
    """Watch for an environment.

    Raises:
        ValueError: if both model and terms are given, if the file holds no model, or as `Watch` does.
    """
    if model is not None and terms is not None:
        raise ValueError("a model has its terms: give either model or terms")
    if isinstance(model, str | Path):
        model = Model.load(model)
    rate = rate_of(env, rate)
    chosen = chosen_terms(terms) if model is None else model.terms
    theta = None if model is None else model.theta
    return Watch(rate, chosen, batch=batch, smoothing=smoothing_of(env, rate), theta=theta, **options)
