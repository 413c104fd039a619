"""Wrappers that report which effect a model lacks and which parameters have changed, while the environment runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from estimators.arguments import model_that_moves
from estimators.online.change import Fit
from estimators.online.diagnosis import Diagnoser, find_obstacle
from estimators.wrappers.measuring import Measuring, MeasuringVector
from estimators.wrappers.options import AnyEnv, Plant
from pendulum_env.arms.model import load_model
from pendulum_env.physics import Model, Term
from pendulum_env.physics.mechanism import describe_joints


class DiagnoseOnline(Measuring):
    """Compare the model with the same model and each effect of the library, from the measurement in `info`.

    Adds `diagnosis` to `info`, an `estimators.online.OnlineDiagnosis`, which changes once per second of motion: what
    every effect gains in predicting (`ranking`), and the effect that is missing, with those that may as well be in its
    place (`group`). Parameters that change while it runs are reported with their change and standard error (`changed`)
    and the time (`since`); the running model takes the new values. `add(effect)` takes an effect into the running
    model, `undo()` takes the last one out. Both begin the comparison anew, and so does a reset, which also takes out
    all that was added.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import DiagnoseOnline
        >>> env = DiagnoseOnline(gym.make("pendulum_env/DirectDrivePendulum-v0", effects=["cogging"]))
        >>> _, info = env.reset(seed=0)
        >>> info["diagnosis"].kind
        'calibrating'
        >>> sorted(info["diagnosis"].not_run)
        ['actuator_lag', 'backlash', 'dead_time', 'joint_flexibility', 'payload_change', 'presliding']
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        terms: Sequence[str | Term] | None = None,
        *,
        candidates: str | Sequence[str] | None = None,
        rate: float | None = None,
        add_from: float | None = None,
        alarms_per_hour: float = 1.0,
        model: Model | str | Path | None = None,
        robot: str | None = None,
    ) -> None:
        """Wrap an environment whose `info` carries `time`, `position` and `torque`.

        Args:
            env: the environment.
            terms: of the model, by id or as they are; None are those of `model` or, without one, the paper's four, or
                the links of the environment's arm with viscous and Coulomb friction at each joint.
            candidates: ids of effects that it may lack, or one; None are all of the library. Of an arm, `stribeck` is
                at any joint, `stribeck@elbow` at that one.
            rate: samples per second [Hz]; None asks the environment, as for its encoder, whose steps are smoothed.
            add_from: probability from which an effect that is surely missing is added by itself; None adds none.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.
            model: an identified model, or its file, in the place of `terms`. Parameters of the plant that differ
                significantly from its parameters are reported as changed after five seconds of motion. `add`, `undo`
                and an accepted change end this comparison until the next reset.
            robot: file of an arm's links, URDF or MJCF; None asks the environment.

        Raises:
            ValueError: if a name is unknown, a number out of its range, a term of the model depends on the past, no
                candidate can be followed, both model and terms are given, the model is per another unit of torque, or
                a file holds no model; when running, if samples do not come at the rate.
        """
        if add_from is not None and not 0.5 <= add_from < 1:
            raise ValueError(f"add_from ({add_from:g}) is a probability: give 0.5 or more, below 1")
        arguments: dict[str, Any] = {"terms": terms, "candidates": candidates, "rate": rate, "robot": robot}
        arguments |= {"alarms_per_hour": alarms_per_hour, "model": model}
        diagnoser = diagnoser_of(env, **arguments)
        super().__init__(env, diagnoser, add_from=add_from, **arguments)
        (self.diagnoser,) = diagnoser.each
        self._add_from, self._last_diagnosis = add_from, self.diagnoser.diagnosis

    def add(self, effect: str) -> Term:
        """Take an effect into the running model, with the nonlinear parameters that predicted best, and return it.

        The comparison with the parameters of `model` ends.

        Raises:
            ValueError: if it is unknown, not run, in the model already, or not yet tried.
        """
        return self.diagnoser.add(effect)

    def undo(self) -> None:
        """Take the effect that was added last out of the running model.

        The comparison with the parameters of `model` ends.

        Raises:
            ValueError: if none was added.
        """
        self.diagnoser.undo()

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        diagnosis, before = self.diagnoser.diagnosis, self._last_diagnosis
        self._last_diagnosis = diagnosis
        if self._add_from is not None and diagnosis is not before and diagnosis.kind == "missing":
            (first,) = (entry for entry in diagnosis.ranking if entry.effect == diagnosis.group[0])
            if first.probability >= self._add_from:
                self.add(first.effect)
        info["diagnosis"] = self.diagnoser.diagnosis
        return observation


class DiagnoseOnlineVector(MeasuringVector):
    """`DiagnoseOnline` for a vector environment: `info` has a diagnosis for each; a reset pendulum starts anew.

    `diagnoser.each` holds one monitor a pendulum, with `add` and `undo`.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], terms: Sequence[str | Term] | None = None, **options: Any
    ) -> None:
        """Wrap a vector environment; the arguments are those of `DiagnoseOnline`, but for `add_from`."""
        self.diagnoser = diagnoser_of(env, terms, **options)
        super().__init__(env, self.diagnoser)

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        info["diagnosis"] = np.empty(self.num_envs, dtype=object)
        info["diagnosis"][:] = self.diagnoser.diagnoses
        info["_diagnosis"] = np.ones(self.num_envs, dtype=bool)
        return observation


def diagnoser_of(
    env: AnyEnv,
    terms: Sequence[str | Term] | None = None,
    *,
    candidates: str | Sequence[str] | None = None,
    rate: float | None = None,
    model: Model | str | Path | None = None,
    robot: str | None = None,
    **options: Any,
) -> Diagnoser:
    """Diagnoser for an environment, or for each of a vector; the arguments are those of `DiagnoseOnline`.

    Raises:
        ValueError: if a name is unknown, none of the candidates can be followed online, both model and terms are given,
            or the model is that of another plant or per another unit of torque.
    """
    if model is not None and terms is not None:
        raise ValueError("a model has its terms: give either model or terms")
    plant = Plant.of(env, rate, robot)
    if model is None:
        chosen, given = plant.terms(terms), None
    else:
        chosen, given = load_given(model, plant)
    library = plant.effects([candidates] if isinstance(candidates, str) else candidates)
    if library is not None and all(map(find_obstacle, library.values())):
        why = ", ".join(f"{id} ({find_obstacle(one)})".replace("_", " ") for id, one in library.items())
        raise ValueError(f"candidates leave no effect to try{': ' * bool(why)}{why}; name others, or None for all")
    known: dict[str, Any] = {"library": library, "smoothing": plant.smoothing, "given": given}
    return Diagnoser(plant.rate, chosen, batch=plant.batch, **known, **options)


def load_given(model: Model | str | Path, plant: Plant) -> tuple[tuple[Term, ...], Fit]:
    """Return terms and estimates of a model, or of its file; the errors of unknown estimates are infinite.

    Raises:
        ValueError: if the model is that of another kind of plant or per another unit, or lacks inertia, or a file holds
            no model.
    """
    if isinstance(model, str | Path):
        model = load_model(model, plant.body)
    if model.body.joints != plant.body.joints:
        ours, other = (describe_joints(of.joints) for of in (model.body, plant.body))
        raise ValueError(f"the model is of {ours}, and what is diagnosed is {other}: give the model of one")
    model_that_moves(model)
    if model.torque_unit != plant.torque_unit:
        raise ValueError(
            f"the model is per {model.torque_unit}, but the environment measures torque in {plant.torque_unit}: "
            f"give a model that was identified from recordings in {plant.torque_unit}"
        )
    estimates = [model.estimates[column.name] for term in model.terms for column in term.columns]
    std = [np.inf if estimate.is_unknown else estimate.std for estimate in estimates]
    return model.terms, Fit(model.theta, np.diag(np.square(std)))
