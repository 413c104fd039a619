"""What the learning wrappers are asked for, and what they ask their environment: names in, terms and schemes out."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict, cast

import gymnasium as gym

from estimators.arguments import chosen_terms
from estimators.online import JointState, OnlineEstimator
from estimators.online.clock import check_rate
from estimators.schemes.six import SCHEMES, Scheme, chosen_schemes
from estimators.signals.differentiation import encoder_noise
from estimators.signals.measurements import Smoothing, choose_smoothing, of_steps
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.joints import Coupling, arm_base, effects_of, kinds_at, model_terms
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.interface import note_identifier
from pendulum_env.lookup import find
from pendulum_env.physics import Term
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE

Names = str | Sequence[str | Scheme | JointState]
AnyEnv = gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]


class EstimatorOptions(TypedDict, total=False):
    """Options of `OnlineEstimator` that a wrapper passes on; None is the default."""

    forgetting: float | None
    random_walk: float | Sequence[float] | None
    prior: float | None
    counts: int | None
    smoothing: Smoothing | None
    recursion: str | None


def chosen_online(names: Names) -> tuple[Scheme | JointState, ...]:
    """Schemes by id, or as they are; "all" are the six, without the joint state, which is told last.

    Raises:
        ValueError: if there is no scheme of a name, or one that only works on whole recordings.
        TypeError: if something is no scheme.
    """
    if names == "all":
        return SCHEMES
    each = [names] if isinstance(names, str) or not isinstance(names, Sequence) else names
    known: dict[str, Scheme | JointState] = {one.id: one for one in SCHEMES}
    known[JointState.id] = JointState()
    listed = [find("scheme", one, known) if isinstance(one, str) else one for one in each]
    joint = [one for one in listed if isinstance(one, JointState)]
    others = [one for one in listed if not isinstance(one, JointState)]
    if len(joint) > 1:
        raise ValueError(f"a scheme is named twice in {joint[0].id}, {joint[1].id}: use each once")
    chosen = chosen_schemes(others) if others or not joint else ()
    return (*cast("tuple[Scheme, ...]", chosen), *joint)


def rate_of(env: AnyEnv, rate: float | None) -> float:
    """Samples per second of an environment [Hz], which somebody needs who is going to estimate.

    Raises:
        ValueError: if neither the caller nor the environment knows, or it is no positive number.
    """
    note_identifier(env)
    known = _attribute(env, "rate") if rate is None else rate
    if known is None:
        raise ValueError("the environment does not say its sampling rate: pass rate=... in Hz")
    return check_rate(float(known))


def smoothing_of(env: AnyEnv, rate: float) -> Smoothing:
    """Smoothing for an environment's encoder or the recording it plays; for the paper's encoder if neither is known."""
    recording = _attribute(env, "recording")
    if isinstance(recording, Recording):
        return choose_smoothing(recording)
    noise = position_noise_of(env)
    return Smoothing.of_noise(of_steps(COUNTS) if noise is None else noise, rate)


def position_noise_of(env: AnyEnv) -> float | None:
    """Standard deviation of the measured position [rad]; None if the environment does not tell its encoder."""
    recording = _attribute(env, "recording")
    if isinstance(recording, Recording):
        return encoder_noise(recording.position)
    counts = _attribute(env, "counts")
    return None if counts is None else of_steps(counts)


def _attribute(env: AnyEnv, name: str) -> Any:
    """Attribute of the innermost environment, of the first of several; None if it has none."""
    inner = env.unwrapped
    if isinstance(inner, gym.vector.SyncVectorEnv):
        inner = inner.envs[0].unwrapped
    return getattr(inner, name, None)


def body_in(env: gym.Env[Any, Any], robot: str | None = None) -> Body:
    """Links of a file, or of an environment that can write them.

    Raises:
        ValueError: if there is no file, and the environment does not tell, or the file has more joints or fewer.
    """
    if robot is not None:
        body = read_body(robot)
        joints = tuple(getattr(env.unwrapped, "joints", body.joints))
        if len(joints) != len(body.joints):
            raise ValueError(f"the environment has joints {', '.join(joints)}, and {robot} {', '.join(body.joints)}")
        return body
    text = getattr(env.unwrapped, "urdf", None)
    if text is None:
        raise ValueError("the environment does not tell its links: pass robot=, a file in URDF or MJCF")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return read_body(path)


@dataclass(frozen=True)
class Plant:
    """What a learner has to know of the plant in an environment.

    Attributes:
        rate: samples per second [Hz].
        smoothing: of the measurement.
        batch: of how many environments there are.
        body: its joints; of an arm, its links.
        torque_unit: unit of the measured torque, that of the recording which the environment plays or N m.
    """

    rate: float
    smoothing: Smoothing
    batch: int
    body: Mechanism
    torque_unit: str

    @classmethod
    def of(cls, env: AnyEnv, rate: float | None = None, robot: str | None = None) -> Plant:
        """Ask an environment for what is not given; an arm is one that names its joints, or has a file of its links.

        Raises:
            ValueError: if nobody knows the rate, or the links of an arm; if the environment is a vector of arms.
        """
        rate, body = rate_of(env, rate), PENDULUM
        if robot is not None or _attribute(env, "joints") is not None:
            if not isinstance(env, gym.Env):
                raise ValueError("arms are followed one by one: wrap each environment of the vector")
            body = body_in(env, robot)
        recording = _attribute(env, "recording")
        unit = recording.torque_unit if isinstance(recording, Recording) else NEWTON_METRE
        return cls(rate, smoothing_of(env, rate), getattr(env, "num_envs", 1), body, unit)

    def terms(self, terms: Sequence[str | Term] | None) -> tuple[Term, ...]:
        """Model of a pendulum, or of an arm: its links and terms at joints, viscous and Coulomb friction by default.

        Raises:
            ValueError: if a term is unknown or at no joint.
        """
        return arm_base(self.body) if terms is None else chosen_terms(model_terms(terms, self.body))

    def effects(self, names: Sequence[str] | None) -> dict[str, type[Term]]:
        """Effects that may be missing, by id; `stribeck` is at each joint of an arm; by default all that `info` shows.

        Raises:
            ValueError: if there is no such effect or joint.
        """
        if names is None:
            names = [id for id, kind in effects_of(self.body).items() if id != Coupling.id and not kind.needs]
        return {kind.id: kind for kind in kinds_at(names, self.body)}


def make(
    env: AnyEnv,
    schemes: Names,
    terms: Sequence[str | Term] | None,
    rate: float | None,
    options: EstimatorOptions,
    robot: str | None = None,
) -> OnlineEstimator:
    """Estimator for an environment, or for each of a vector; see `OnlineEstimator` for the options.

    Raises:
        ValueError: as `Plant` does, or if there is no such option.
    """
    own = ("schemes", "terms", "rate", "in_observation", *EstimatorOptions.__annotations__)
    for name in options:
        find("argument", name, dict.fromkeys(own))
    plant = Plant.of(env, rate, robot)
    known: dict[str, Any] = {"batch": plant.batch}
    noise = position_noise_of(env)
    if noise is not None and options.get("counts") is None:
        known |= {"smoothing": plant.smoothing, "position_noise": noise}
    known |= {name: value for name, value in options.items() if value is not None}
    return OnlineEstimator(plant.rate, plant.terms(terms), chosen_online(schemes), **known)
