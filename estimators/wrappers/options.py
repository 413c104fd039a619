"""What the estimating wrappers are asked for: names in, terms and schemes out, so that an env's spec can be rebuilt."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import gymnasium as gym

from estimators.arguments import chosen_schemes, chosen_terms
from estimators.online import JointState, OnlineEstimator
from estimators.online.clock import checked_rate
from estimators.schemes.six import SCHEMES, Scheme
from estimators.signals.differentiation import encoder_noise
from estimators.signals.measurements import Smoothing, choose_smoothing, of_steps
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.interface import note_identifier
from pendulum_env.lookup import find
from pendulum_env.physics import Term
from pendulum_env.recording import Recording

Names = str | Sequence[str | Scheme | JointState]
AnyEnv = gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]


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
    return checked_rate(float(known))


def is_arm(env: AnyEnv) -> bool:
    """Whether an environment has several joints, or one of an arm: then it names them."""
    return _attribute(env, "joints") is not None


def smoothing_of(env: AnyEnv, rate: float) -> Smoothing:
    """Smoothing for an environment's encoder or the recording it plays; for the paper's encoder if neither is known."""
    recording = _attribute(env, "recording")
    if isinstance(recording, Recording):
        return choose_smoothing(recording)
    counts = _attribute(env, "counts")
    return Smoothing.of_encoder(COUNTS if counts is None else counts, rate)


def position_noise_of(env: AnyEnv) -> float:
    """Standard deviation of the measured position [rad]; of the paper's encoder if the environment says nothing."""
    recording = _attribute(env, "recording")
    if isinstance(recording, Recording):
        return encoder_noise(recording.position)
    counts = _attribute(env, "counts")
    return of_steps(COUNTS if counts is None else counts)


def _attribute(env: AnyEnv, name: str) -> Any:
    """Attribute of the innermost environment, of the first of several; None if it has none."""
    inner = env.unwrapped
    if isinstance(inner, gym.vector.SyncVectorEnv):
        inner = inner.envs[0].unwrapped
    return getattr(inner, name, None)


def make(
    env: AnyEnv,
    schemes: Names,
    terms: Sequence[str | Term] | None,
    rate: float | None,
    batch: int,
    options: dict[str, Any],
) -> OnlineEstimator:
    """Estimator for an environment; see `OnlineEstimator` for the options.

    Raises:
        ValueError: if the environment is a vector of arms.
    """
    if is_arm(env):
        raise ValueError("arms are estimated one by one: wrap each environment of the vector")
    rate = rate_of(env, rate)
    if options.get("smoothing") is None:
        options = {**options, "smoothing": smoothing_of(env, rate)}
    if options.get("position_noise") is None:
        options = {**options, "position_noise": position_noise_of(env)}
    return OnlineEstimator(rate, chosen_terms(terms), chosen_online(schemes), batch=batch, **options)
