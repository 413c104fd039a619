"""Arguments of the online wrappers, and properties of their environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict, Unpack, cast

import gymnasium as gym

from estimators.arguments import select_terms
from estimators.online import JointState, OnlineEstimator
from estimators.online.stream import check_rate
from estimators.schemes.six import SCHEMES, Scheme, select_schemes
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.signals.measurements import Smoothing, choose_smoothing, compute_encoder_noise
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.lookup import find
from pendulum_env.physics import PENDULUM, Mechanism, Term
from pendulum_env.physics.joints import Coupling, arrange_terms, find_kinds, list_base_terms, list_effects
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.recording import NEWTON_METRE, Recording
from pendulum_env.robot_file import find_link_reader

Names = str | Sequence[str | Scheme | JointState]
AnyEnv = gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]


class EstimatorOptions(TypedDict, total=False):
    """Options of `OnlineEstimator` that a wrapper passes on; None for the default."""

    forgetting: float | None
    prior: float | None
    counts: int | None
    smoothing: Smoothing | None
    recursion: str | None


def choose_online_schemes(names: Names) -> tuple[Scheme | JointState, ...]:
    """Return schemes by id or object; "all" for the six. The joint state is the last."""
    if names == "all":
        return SCHEMES
    names_or_schemes = [names] if isinstance(names, str) or not isinstance(names, Sequence) else names
    online: tuple[Scheme | JointState, ...] = (*SCHEMES, JointState())
    by_id = {entry.id: entry for entry in online}
    listed = [find("scheme", entry, by_id) if isinstance(entry, str) else entry for entry in names_or_schemes]
    joint = [entry for entry in listed if isinstance(entry, JointState)]
    others = [entry for entry in listed if not isinstance(entry, JointState)]
    if len(joint) > 1:
        raise ValueError(f"a scheme is named twice in {joint[0].id}, {joint[1].id}: use each once")
    chosen = select_schemes(others) if others or not joint else ()
    return (*cast("tuple[Scheme, ...]", chosen), *joint)


def _get_attribute(env: AnyEnv, name: str) -> Any:
    """Return an attribute of the innermost environment, or of the first one in a `SyncVectorEnv`; None if missing."""
    inner = env.unwrapped
    if isinstance(inner, gym.vector.SyncVectorEnv):
        inner = inner.envs[0].unwrapped
    return getattr(inner, name, None)


def read_links(env: gym.Env[Any, Any], robot: str | None = None) -> LinkedMechanism:
    """Read the links of a file, or of an environment with the attribute `urdf`."""
    reader = find_link_reader()
    if robot is not None:
        mechanism = reader.read(robot)
        joints = tuple(getattr(env.unwrapped, "joints", mechanism.joints))
        if len(joints) != len(mechanism.joints):
            raise ValueError(
                f"the environment has joints {', '.join(joints)}, and {robot} {', '.join(mechanism.joints)}"
            )
        return mechanism
    text = getattr(env.unwrapped, "urdf", None)
    if text is None:
        raise ValueError("the environment has no attribute urdf: pass robot=, a URDF or MJCF file")
    return reader.parse(text)


@dataclass(frozen=True)
class Plant:
    """Properties of an environment's plant for an online algorithm.

    Attributes:
        rate: sampling rate [Hz].
        position_noise: standard deviation of the measured position [rad]; None for an unknown encoder.
        smoothing: smoothing for this noise, or for the recording that is played; by default for the paper's encoder.
        batch: number of environments.
        mechanism: joint of a pendulum, or several joints with links.
        torque_unit: unit of the recording that the environment plays, or N m.
        is_replay: True if the environment plays a recording.
    """

    rate: float
    position_noise: float | None
    smoothing: Smoothing
    batch: int
    mechanism: Mechanism
    torque_unit: str
    is_replay: bool = False

    @classmethod
    def from_env(cls, env: AnyEnv, rate: float | None = None, robot: str | None = None) -> Plant:
        """Read the plant of an environment, with links if it has an attribute `joints` or a robot file is given.

        Raises:
            ValueError: if the rate or the links are unknown, or the environment is a vector of linked mechanisms.
        """
        own_rate, mechanism = _get_attribute(env, "rate") if rate is None else rate, PENDULUM
        if own_rate is None:
            raise ValueError("the environment has no attribute rate: pass rate=... in Hz")
        rate = check_rate(float(own_rate))
        if robot is not None or _get_attribute(env, "joints") is not None:
            if not isinstance(env, gym.Env):
                raise ValueError("a vector of arms has no online algorithm: wrap each arm environment by itself")
            mechanism = read_links(env, robot)
        recording, counts = _get_attribute(env, "recording"), _get_attribute(env, "counts")
        batch = getattr(env, "num_envs", 1)
        if isinstance(recording, Recording):
            known_noise, smoothing = estimate_encoder_noise(recording), choose_smoothing(recording)
            return cls(rate, known_noise, smoothing, batch, mechanism, recording.torque_unit, True)
        noise = None if counts is None else compute_encoder_noise(counts)
        smoothing = Smoothing.from_noise(compute_encoder_noise(COUNTS) if noise is None else noise, rate)
        return cls(rate, noise, smoothing, batch, mechanism, NEWTON_METRE)

    def terms(self, terms: Sequence[str | Term] | None) -> tuple[Term, ...]:
        """Return the terms of the model of a mechanism, with viscous and Coulomb friction by default.

        Raises:
            ValueError: if a term or its joint is unknown.
        """
        return list_base_terms(self.mechanism) if terms is None else select_terms(arrange_terms(terms, self.mechanism))

    def effects(self, names: Sequence[str] | None) -> dict[str, type[Term]]:
        """Return possible effects by id, by default all that need only the columns of `info`.

        With links, `stribeck` selects this effect at each joint.

        Raises:
            ValueError: if an effect or joint is unknown.
        """
        if names is None:
            names = [id for id, kind in list_effects(self.mechanism).items() if id != Coupling.id and not kind.needs]
        return {kind.id: kind for kind in find_kinds(names, self.mechanism)}


def make_estimator(
    env: AnyEnv,
    schemes: Names = "all",
    terms: Sequence[str | Term] | None = None,
    rate: float | None = None,
    robot: str | None = None,
    **options: Unpack[EstimatorOptions],
) -> OnlineEstimator:
    """Make the estimator of an environment or a vector environment; see `OnlineEstimator` for the options.

    Raises:
        ValueError: as in `Plant.from_env`, or if an option is unknown.
    """
    accepted = ("schemes", "terms", "rate", "in_observation", *EstimatorOptions.__annotations__)
    for name in options:
        find("argument", name, dict.fromkeys(accepted))
    plant = Plant.from_env(env, rate, robot)
    arguments: dict[str, Any] = {"batch": plant.batch}
    if plant.position_noise is not None and options.get("counts") is None:
        arguments["position_noise"] = plant.position_noise
        if plant.is_replay:
            arguments["smoothing"] = plant.smoothing
    arguments |= {name: value for name, value in options.items() if value is not None}
    return OnlineEstimator(plant.rate, plant.terms(terms), choose_online_schemes(schemes), **arguments)
