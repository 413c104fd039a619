"""What the estimating wrappers are asked for: names in, terms and schemes out, so that an env's spec can be rebuilt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import gymnasium as gym

from estimators.inputs import chosen_schemes, chosen_terms
from estimators.measurements import Smoothing, choose_smoothing
from estimators.online import OnlineEstimator
from estimators.schemes import OnlineScheme
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.physics import Term
from pendulum_env.recording import Recording

Names = str | Sequence[str | OnlineScheme]
AnyEnv = gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]


def chosen_online(names: Names) -> tuple[OnlineScheme, ...]:
    """Schemes by id, or as they are; "all" are the six.

    Raises:
        ValueError: if there is no scheme of a name, or one that only works on whole recordings.
        TypeError: if something is no scheme.
    """
    chosen = chosen_schemes(names)
    for item in chosen:
        if not hasattr(item, "view"):
            raise ValueError(
                f"{item.id} only works on whole recordings: it does not say which view it takes of a column"
            )
    return cast("tuple[OnlineScheme, ...]", chosen)


def rate_of(env: AnyEnv, rate: float | None) -> float:
    """Samples per second of an environment [Hz].

    Raises:
        ValueError: if neither the caller nor the environment knows.
    """
    known = _attribute(env, "rate") if rate is None else rate
    if known is None:
        raise ValueError("the environment does not say its sampling rate: pass rate=... in Hz")
    return float(known)


def smoothing_of(env: AnyEnv, rate: float) -> Smoothing:
    """Smoothing for an environment's encoder or the recording it plays; for the paper's encoder if neither is known."""
    recording = _attribute(env, "recording")
    if isinstance(recording, Recording):
        return choose_smoothing(recording)
    counts = _attribute(env, "counts")
    return Smoothing.of_encoder(COUNTS if counts is None else counts, rate)


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
    """Estimator for an environment; see `OnlineEstimator` for the options."""
    rate = rate_of(env, rate)
    if options.get("smoothing") is None:
        options = {**options, "smoothing": smoothing_of(env, rate)}
    return OnlineEstimator(rate, chosen_terms(terms), chosen_online(schemes), batch=batch, **options)


def check_rate(passed: float, rate: float) -> None:
    """Refuse samples that do not come at the rate.

    Args:
        passed: time since the last sample, infinite for the first [s].
        rate: samples per second [Hz].

    Raises:
        ValueError: if more than a tenth of a period is missing or too much.
    """
    if not 0.9 < passed * rate < 1.1 and passed * rate != math.inf and passed == passed:
        raise ValueError(
            f"samples come every {passed:.4g} s, not at {rate:g} Hz: pass their rate to EstimateParameters"
        )


def measured(info: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Time, position and torque of a sample.

    Raises:
        KeyError: if the environment does not measure.
    """
    try:
        return info["time"], info["position"], info["torque"]
    except KeyError as error:
        raise KeyError(f"info lacks {error}: the wrapped environment has to carry time, position and torque") from None
