"""Wrappers that tell whether the model still predicts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.vector import VectorEnv

from estimators.online.watch import Watch
from estimators.wrappers.measuring import Measuring, MeasuringVector
from estimators.wrappers.options import AnyEnv, Plant
from pendulum_env.arms.model import ArmModel
from pendulum_env.physics import Model, Term


class WatchModel(Measuring):
    """Tell online whether the model still predicts, from the measurement in `info`.

    Adds `watch` to `info`, an `estimators.online.Verdict`: its `kind` is "calibrating", then "predicts" until an alarm,
    then "changed" while it is not clear how, then "value" (a parameter changed: `parameter`, `changes`, `since`) or
    "structure" (no value explains it: `where`). A changed value becomes the model's after ten seconds of motion; of a
    wrong structure, nothing more is learnt until `accept()` or a reset.

    An arm is watched alike; parameters and places are told with their joint, `viscous@elbow`. It needs the extra
    `arms`.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import WatchModel
        >>> env = WatchModel(gym.make("pendulum_env/DirectDrivePendulum-v0"), alarms_per_hour=0.1)
        >>> _, info = env.reset(seed=0)
        >>> info["watch"].kind
        'calibrating'
    """

    key = "watch"

    def __init__(
        self,
        env: gym.Env[Any, Any],
        model: Model | str | Path | None = None,
        *,
        terms: Sequence[str | Term] | None = None,
        rate: float | None = None,
        alarms_per_hour: float = 1.0,
        calibrate: float = 5.0,
        robot: str | None = None,
    ) -> None:
        """Wrap an environment whose `info` carries `time`, `position` and `torque`.

        Args:
            env: the environment.
            model: an identified model that is watched, or its file; None learns its parameters while it calibrates.
            terms: of the model, by id or as they are, where none is given; None are the paper's four, or the links of
                the environment's arm with viscous and Coulomb friction at each joint.
            rate: samples per second [Hz]; None asks the environment, as for its encoder, whose steps are smoothed.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.
            calibrate: time of motion in which the model, or at least the size of its errors, is learnt [s].
            robot: file of an arm's links, URDF or MJCF; None asks the environment.

        Raises:
            ValueError: if a name is unknown, a number is out of its range, both model and terms are given, or a file
                holds no model; when running, if samples do not come at the rate.
        """
        arguments: dict[str, Any] = {"model": model, "terms": terms, "rate": rate, "robot": robot}
        arguments |= {"alarms_per_hour": alarms_per_hour, "calibrate": calibrate}
        self.watch = watch_of(env, **arguments)
        super().__init__(env, self.watch, **arguments)

    def accept(self) -> None:
        """The plant is now as it shall be: calibrate anew."""
        self.watch.accept()


class WatchModelVector(MeasuringVector):
    """`WatchModel` for a vector environment: `info` has a verdict for each; a reset pendulum starts anew."""

    key = "watch"

    def __init__(self, env: VectorEnv[Any, Any, Any], model: Model | str | Path | None = None, **options: Any) -> None:
        """Wrap a vector environment; the arguments are those of `WatchModel`."""
        self.watch = watch_of(env, model, **options)
        super().__init__(env, self.watch)


def watch_of(
    env: AnyEnv,
    model: Model | str | Path | None = None,
    *,
    terms: Sequence[str | Term] | None = None,
    rate: float | None = None,
    robot: str | None = None,
    **options: Any,
) -> Watch:
    """Watch for an environment, or for each of a vector; the arguments are those of `WatchModel`.

    Raises:
        ValueError: if both model and terms are given, if the file holds no model, or as `Watch` does.
    """
    if model is not None and terms is not None:
        raise ValueError("a model has its terms: give either model or terms")
    plant = Plant.of(env, rate, robot)
    body = plant.body
    if isinstance(model, str | Path):
        model = Model.load(model) if body is None else ArmModel.load(model, body)
    if model is not None and isinstance(model, ArmModel) != (body is not None):
        ours, other = ("an arm", "a pendulum") if body is None else ("a pendulum", "an arm")
        raise ValueError(f"the model is of {ours}, and what is watched is {other}: give the model of one")
    chosen, theta = (plant.terms(terms), None) if model is None else (model.terms, model.theta)
    return Watch(plant.rate, chosen, batch=plant.batch, smoothing=plant.smoothing, theta=theta, **options)
