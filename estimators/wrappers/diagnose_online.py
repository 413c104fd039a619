"""A wrapper that says which effect a model lacks, while the environment runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv

from estimators.arguments import chosen_terms
from estimators.online.diagnosers import Diagnosers
from estimators.online.diagnosis import Diagnoser, OnlineDiagnosis, hindrance
from estimators.wrappers.options import AnyEnv, SampleClock, rate_of, smoothing_of
from estimators.wrappers.vector import MeasuringVector
from pendulum_env.physics import Term
from pendulum_env.physics.library import effect


class DiagnoseOnline(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Compare the model with the same model and each effect of the library, from the measurement in `info`.

    Adds `diagnosis` to `info`, an `estimators.online.OnlineDiagnosis`, which changes once per second of motion: what
    every effect gains in predicting (`ranking`), and the effect that is missing, with those that may as well be in its
    place (`group`). `add(effect)` takes one into the running model, `undo()` takes the last one out; both begin the
    comparison anew, and so does a reset, which also takes out all that was added.

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
    ) -> None:
        """Wrap an environment whose `info` carries `time`, `position` and `torque`.

        Args:
            env: the environment.
            terms: of the model, by id or as they are; None are the paper's four.
            candidates: ids of effects that it may lack, or one; None are all of the library.
            rate: samples per second [Hz]; None asks the environment, as for its encoder, whose steps are smoothed.
            add_from: probability from which an effect that is surely missing is added by itself; None adds none.
            alarms_per_hour: false ones that are accepted, on average, per hour of motion.

        Raises:
            ValueError: if a name is unknown, a number out of its range, a term of the model depends on the past, or no
                candidate can be followed; when running, if samples do not come at the rate.
        """
        options: dict[str, Any] = {"rate": rate, "add_from": add_from, "alarms_per_hour": alarms_per_hour}
        gym.utils.RecordConstructorArgs.__init__(self, terms=terms, candidates=candidates, **options)
        gym.Wrapper.__init__(self, env)
        if add_from is not None and not 0.5 <= add_from < 1:
            raise ValueError(f"add_from ({add_from:g}) is a probability: give 0.5 or more, below 1")
        self.diagnoser = Diagnoser(**_of(env, terms, candidates, rate, alarms_per_hour))
        self._add_from, self._clock = add_from, SampleClock(self.diagnoser.rate)
        self._seen: OnlineDiagnosis | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment and begin with the model as it was given."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.diagnoser.reset()
        self._clock.restart()
        return observation, self._tell(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment and let every model predict its measurement."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, self._tell(info)

    def add(self, effect: str) -> Term:
        """Take an effect into the running model, with the shape that predicted best so far, and return it.

        Raises:
            ValueError: if it is unknown, not run, in the model already, or not yet tried.
        """
        return self.diagnoser.add(effect)

    def undo(self) -> None:
        """Take the effect that was added last out of the running model.

        Raises:
            ValueError: if none was added.
        """
        self.diagnoser.undo()

    def _tell(self, info: dict[str, Any]) -> dict[str, Any]:
        if "fault" not in info:  # with one, nothing was measured
            time, position, torque = self._clock.measured(info)
            said = self.diagnoser.take(float(time), float(position), float(torque))
            if said is not self._seen:
                self._seen = said
                self._add_surest(said)
        info["diagnosis"] = self.diagnoser.said
        return info

    def _add_surest(self, said: OnlineDiagnosis) -> None:
        if self._add_from is None or said.kind != "missing":
            return
        if sum(one.probability for one in said.ranking if one.effect in said.group[:1]) >= self._add_from:
            self.add(said.group[0])


class DiagnoseOnlineVector(MeasuringVector):
    """`DiagnoseOnline` for a vector environment: `info` has a diagnosis for each; a reset pendulum starts anew.

    `diagnosers.each` holds one `Diagnoser` per pendulum, with `add` and `undo`.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        terms: Sequence[str | Term] | None = None,
        *,
        candidates: str | Sequence[str] | None = None,
        rate: float | None = None,
        alarms_per_hour: float = 1.0,
    ) -> None:
        """Wrap a vector environment; the arguments are those of `DiagnoseOnline`."""
        super().__init__(env)
        self.diagnosers = Diagnosers(batch=env.num_envs, **_of(env, terms, candidates, rate, alarms_per_hour))

    def _add(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        anew, sample = self._measured(info)
        self.diagnosers.reset(anew)
        info["diagnosis"] = self.diagnosers.take(*sample)
        info["_diagnosis"] = np.ones(self.num_envs, dtype=bool)
        return observation, info


def _of(
    env: AnyEnv,
    terms: Sequence[str | Term] | None,
    candidates: str | Sequence[str] | None,
    rate: float | None,
    alarms_per_hour: float,
) -> dict[str, Any]:
    """What a diagnoser of an environment needs.

    Raises:
        ValueError: if a name is unknown, or none of the candidates can be followed online.
    """
    rate = rate_of(env, rate)
    candidates = [candidates] if isinstance(candidates, str) else candidates
    library = None if candidates is None else {id: effect(id) for id in candidates}
    if library is not None and all(map(hindrance, library.values())):
        why = ", ".join(f"{id} {hindrance(one)}" for id, one in library.items())
        raise ValueError(f"candidates leave no effect to try{': ' * bool(why)}{why}; name others, or None for all")
    return {
        "rate": rate,
        "terms": chosen_terms(terms),
        "library": library,
        "smoothing": smoothing_of(env, rate),
        "alarms_per_hour": alarms_per_hour,
    }
