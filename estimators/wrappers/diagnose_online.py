"""Wrappers for online diagnosis: missing effects and changed parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from estimators.arguments import check_model
from estimators.decisions.criterion import Criterion
from estimators.online.change import ParameterFit
from estimators.online.diagnosis import Diagnoser, EffectMonitor, find_obstacle
from estimators.online.worker import DiagnoserProcess, MonitorProxy
from estimators.wrappers.measuring import MeasurementVectorWrapper, MeasurementWrapper
from estimators.wrappers.options import AnyEnv, Plant
from pendulum_env.physics import Model, Term, describe_joints
from pendulum_env.physics.model import load_model


class DiagnoseOnline(MeasurementWrapper):
    """Diagnose the model online, from the measurements in `info`.

    The wrapper adds `diagnosis` to `info`, an `estimators.online.OnlineDiagnosis`, which is updated once per second of
    motion. It has the gain of each effect in prediction (`ranking`), and the missing effect with its competitors
    (`group`). Parameters that change are reported with their change and standard error (`changed`) and the time
    (`since`); the running model takes the new values. `add(effect)` adds an effect to the running model, and `undo()`
    removes the last one. Both restart the comparison. A reset restarts it, too, and removes all added effects.

    Each step computes a few parts of the fits. An update therefore comes some steps after its second.

    Examples:
        >>> import gymnasium as gym
        >>> from estimators.wrappers import DiagnoseOnline
        >>> env = DiagnoseOnline(gym.make("pendulum_env/DirectDrivePendulum-v0", effects=["cogging"]))
        >>> _, info = env.reset(seed=0)
        >>> info["diagnosis"].kind
        'calibrating'
        >>> sorted(info["diagnosis"].not_run)
        ['backlash', 'joint_flexibility', 'payload_change', 'presliding']
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        terms: Sequence[str | Term] | None = None,
        *,
        candidates: str | Sequence[str] | None = None,
        rate: float | None = None,
        alarms_per_hour: float = 1.0,
        model: Model | str | Path | None = None,
        robot: str | None = None,
        criterion: Criterion | None = None,
        worker: bool = False,
    ) -> None:
        """Wrap an environment with `time`, `position` and `torque` in `info`.

        Args:
            env: the environment.
            terms: terms of the model, ids or `Term` objects. By default those of `model`, or the four of the paper, or
                the links with viscous and Coulomb friction at each joint.
            candidates: ids of possible effects, or one id; None for all of the library. With links, `stribeck` is
                possible at each joint, `stribeck@elbow` at one.
            rate: sampling rate [Hz]; None reads it from the environment, as the encoder.
            alarms_per_hour: accepted mean number of false alarms per hour of motion.
            model: identified model, or its file, instead of `terms`. Parameters of the plant that differ
                significantly from those of the model are reported as changed after five seconds of motion. `add`,
                `undo` and an accepted change end this comparison until the next reset.
            robot: URDF or MJCF file of the links; None reads it from the environment.
            criterion: limits of the decisions, as of `diagnose`; `env.spec` of an environment cannot hold them.
            worker: True to run the diagnosis in a process of its own, until `close`. A step then takes less than 0.1 ms
                of it, and `info["diagnosis"]` is the latest one, up to a second old. Scripts need the usual
                `if __name__ == "__main__"` where processes are spawned, as on Windows and macOS.

        Raises:
            ValueError: if a name is unknown, a number is out of its range, a term of the model depends on the past,
                no candidate has an online diagnosis, both model and terms are given, the torque unit of the model is
                wrong, or a file holds no model; while running, if samples are off the rate.
        """
        arguments: dict[str, Any] = {"terms": terms, "candidates": candidates, "rate": rate, "robot": robot}
        arguments |= {"alarms_per_hour": alarms_per_hour, "model": model}
        if criterion is not None:
            arguments["criterion"] = criterion
        diagnoser = make_diagnoser(env, **arguments, worker=worker)
        super().__init__(env, diagnoser, **arguments, worker=worker)
        self.diagnoser: EffectMonitor | MonitorProxy = diagnoser.each[0]

    def add(self, effect: str) -> Term:
        """Add an effect to the running model with the nonlinear parameters that predicted best, and return it.

        The comparison with the parameters of `model` ends.

        Raises:
            ValueError: if the effect is unknown, not run, in the model already, or not tried yet.
        """
        return self.diagnoser.add(effect)

    def undo(self) -> None:
        """Remove the effect that was added last.

        The comparison with the parameters of `model` ends.

        Raises:
            ValueError: if no effect was added.
        """
        self.diagnoser.undo()

    def close(self) -> None:
        """Close the environment, and end the process of a worker."""
        super().close()
        if isinstance(self._algorithm, DiagnoserProcess):
            self._algorithm.close()

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        info["diagnosis"] = self.diagnoser.diagnosis
        return observation


class DiagnoseOnlineVector(MeasurementVectorWrapper):
    """`DiagnoseOnline` for a vector environment: `info` has one diagnosis per environment.

    `diagnoser.each` holds one monitor per environment, with `add` and `undo`.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], terms: Sequence[str | Term] | None = None, **options: Any
    ) -> None:
        """Wrap a vector environment; the arguments are those of `DiagnoseOnline`."""
        self.diagnoser = make_diagnoser(env, terms, **options)
        super().__init__(env, self.diagnoser)

    def close(self, **kwargs: Any) -> None:
        """Close the environments, and end the process of a worker."""
        super().close(**kwargs)
        if isinstance(self.diagnoser, DiagnoserProcess):
            self.diagnoser.close()

    def _write_info(self, observation: Any, info: dict[str, Any]) -> Any:
        info["diagnosis"] = np.empty(self.num_envs, dtype=object)
        info["diagnosis"][:] = self.diagnoser.diagnoses
        info["_diagnosis"] = np.ones(self.num_envs, dtype=bool)
        return observation


def make_diagnoser(
    env: AnyEnv,
    terms: Sequence[str | Term] | None = None,
    *,
    candidates: str | Sequence[str] | None = None,
    rate: float | None = None,
    model: Model | str | Path | None = None,
    robot: str | None = None,
    worker: bool = False,
    **options: Any,
) -> Diagnoser | DiagnoserProcess:
    """Make the diagnosis of an environment or a vector environment; the arguments are those of `DiagnoseOnline`.

    Raises:
        ValueError: if a name is unknown, no candidate has an online diagnosis, both model and terms are given, or the
            joints or the torque unit of the model differ from the environment.
    """
    if model is not None and terms is not None:
        raise ValueError("model and terms are both given: give one of them")
    plant = Plant.from_env(env, rate, robot)
    if model is None:
        chosen_terms, reference = plant.terms(terms), None
    else:
        chosen_terms, reference = load_reference(model, plant)
    library = plant.effects([candidates] if isinstance(candidates, str) else candidates)
    if library is not None and all(map(find_obstacle, library.values())):
        reasons = ", ".join(f"{id} ({find_obstacle(effect)})".replace("_", " ") for id, effect in library.items())
        raise ValueError(
            f"no candidate has an online diagnosis{': ' * bool(reasons)}{reasons}; give others, or None for all"
        )
    smoothing = replace(plant.smoothing, halt_width=None)  # keeps more samples near reversals
    arguments: dict[str, Any] = {"library": library, "smoothing": smoothing, "given": reference}
    diagnoser = Diagnoser(plant.rate, chosen_terms, batch=plant.batch, **arguments, **options)
    return DiagnoserProcess(diagnoser) if worker else diagnoser


def load_reference(model: Model | str | Path, plant: Plant) -> tuple[tuple[Term, ...], ParameterFit]:
    """Return terms and estimates of a model or its file; standard errors of unknown estimates are infinite."""
    if isinstance(model, str | Path):
        model = load_model(plant.mechanism, model)
    if model.mechanism.joints != plant.mechanism.joints:
        model_joints, env_joints = (
            describe_joints(mechanism.joints) for mechanism in (model.mechanism, plant.mechanism)
        )
        raise ValueError(
            f"the model has {model_joints}, the environment has {env_joints}: give a model of the environment"
        )
    check_model(model)
    if model.torque_unit != plant.torque_unit:
        raise ValueError(
            f"the model is per {model.torque_unit}, but the environment measures torque in {plant.torque_unit}: "
            f"give a model that was identified from recordings in {plant.torque_unit}"
        )
    estimates = [model.estimates[column.name] for term in model.terms for column in term.columns]
    std = [np.inf if estimate.is_unknown else estimate.std for estimate in estimates]
    return model.terms, ParameterFit(model.theta, np.diag(np.square(std)))
