"""How much sooner an excitation makes the parameters known: policies on the same plants, the real estimator beside.

What counts is the real error of the real estimator. Information is the sum of outer products of its own regressor rows
at 1 kHz, clear of stick by its own guard, not what the policy was paid for.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from agents.design_env import RATE, ExcitationDesignVector
from agents.knowledge import COUNT, NOMINAL, log_det
from agents.observer import TICK
from estimators.online import OnlineEstimator
from estimators.schemes import scheme
from pendulum_env._typing import JSON, Array
from pendulum_env.physics import BASE
from pendulum_env.policy import Policy, State

SCHEMA = "pendulum-ident/evaluation@1"
MOMENTS = (2.0, 5.0, 10.0)  # [s] at which errors are told
CLOSE = 0.01  # share of its value that every parameter has to stay within
RESAMPLES = 2000
FRESH = 2**20  # added to seeds, for plants that no training has drawn
Tell = Callable[[str, float], None]
Statistic = Callable[[Array, Array], float]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a policy did and what was learnt, on N plants.

    Attributes:
        errors: RMS of the relative errors of the four parameters at `MOMENTS` (M, N).
        close: time from which on all four stay within `CLOSE` (N,) [s]; inf if they do not.
        log_det: of the information in nominal units (N,) [nat].
        peak: largest |torque| (N,) [N m].
        rms: root mean square of the torque (N,) [N m].
        speed: largest |q'| (N,) [rad/s].
        turns: between the outermost angles (N,).
        seconds_per_action: that the policy took for all plants together [s].
    """

    errors: Array
    close: Array
    log_det: Array
    peak: Array
    rms: Array
    speed: Array
    turns: Array
    seconds_per_action: float


def observe(
    policy: Policy,
    constraint: str,
    plants: int,
    *,
    seed: int = 0,
    effects: Sequence[str] = (),
    scheme_id: str = "filtered_dynamic",
    tell: Callable[[float], None] | None = None,
) -> Outcome:
    """Let a policy excite fresh plants for 10 s, the online estimator beside it at 1 kHz.

    The same seed gives the same plants and the same noise to every policy.
    """
    env = ExcitationDesignVector(plants, constraint=constraint, effects=effects)
    estimator = OnlineEstimator(RATE, BASE, [scheme(scheme_id)], batch=plants)
    observation, info = env.reset(seed=FRESH + seed)
    truth = info["plant"][:, :COUNT]
    estimator.take(np.zeros(plants), info["positions"][:, 0], np.zeros(plants))
    steps = env.steps_per_episode
    errors = np.empty((steps, plants, COUNT))
    torque, position = np.empty((2, steps, plants))
    speed, information = np.zeros(plants), np.zeros((plants, COUNT, COUNT))
    state: State = None
    acting = 0.0
    for k in range(steps):
        begun = time.perf_counter()
        action, state = policy.predict(observation, state, np.full(plants, k == 0), deterministic=True)
        acting += time.perf_counter() - begun
        observation, _, _, _, info = env.step(action)
        for j in range(env.observer.held):
            now = np.full(plants, (k * env.observer.held + j + 1) / RATE)
            known = estimator.take(now, info["positions"][:, j], info["torques"][:, j])
            row = known.regressor * NOMINAL
            information += row[:, :, None] * row[:, None, :]
        errors[k] = known.theta[:, 0] / truth - 1.0
        torque[k], position[k] = info["torque"], info["positions"][:, -1]
        speed = np.maximum(speed, np.abs(np.diff(info["positions"])).max(axis=1) * RATE)
        if tell is not None:
            tell((k + 1) / steps)
    return Outcome(
        errors=np.sqrt((errors**2).mean(axis=2))[[round(moment / TICK) - 1 for moment in MOMENTS]],
        close=stays_within(np.abs(errors).max(axis=2), CLOSE),
        log_det=log_det(information),
        peak=np.abs(torque).max(axis=0),
        rms=np.sqrt((torque**2).mean(axis=0)),
        speed=speed,
        turns=np.ptp(position, axis=0) / (2 * np.pi),
        seconds_per_action=acting / steps,
    )


def stays_within(errors: Array, bound: float) -> Array:
    """Time from which on errors (T, N), one for each tick, stay within a bound (N,) [s]; inf if they never do."""
    outside = errors > bound
    last = len(errors) - np.argmax(outside[::-1], axis=0)  # ticks until the last that is outside
    last = np.where(outside.any(axis=0), last, 0)
    return np.where(last == len(errors), np.inf, (last + 1) * TICK)


def information_ratio(policy: Array, base: Array) -> float:
    """Median of (det M / det M_base)^(1/4), of log determinants on the same plants."""
    return float(np.median(np.exp((policy - base) / COUNT)))


def improvement(policy: Array, base: Array) -> float:
    """Median of the baseline over that of the policy: above 1 is better; NaN where half never get there."""
    numbers = float(np.median(base)), float(np.median(policy))
    return numbers[0] / numbers[1] if np.isfinite(numbers).all() else float("nan")


def interval(statistic: Statistic, policy: Array, base: Array, seed: int = 0) -> tuple[float, float]:
    """Bootstrap interval of 95 % over plants, the same plants for both."""
    picks = np.random.default_rng(seed).integers(len(policy), size=(RESAMPLES, len(policy)))
    values = [statistic(policy[pick], base[pick]) for pick in picks]
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


def evaluation_json(outcomes: dict[str, Outcome], base: str, **setting: object) -> JSON:
    """All policies beside a baseline, for programs; what is infinite or unknown is null."""
    return {
        "schema": SCHEMA,
        **setting,
        "baseline": base,
        "policies": {name: _policy_json(outcome, outcomes[base]) for name, outcome in outcomes.items()},
    }


def _policy_json(outcome: Outcome, base: Outcome) -> JSON:
    errors = {f"{moment:g} s": _quartiles(outcome.errors[m]) for m, moment in enumerate(MOMENTS)}
    gains = {
        f"error {moment:g} s": _against(improvement, outcome.errors[m], base.errors[m])
        for m, moment in enumerate(MOMENTS)
    }
    gains["time to 1 %"] = _against(improvement, outcome.close, base.close)
    gains["information"] = _against(information_ratio, outcome.log_det, base.log_det)
    return {
        "error": errors,
        "time_to_1_percent": _quartiles(outcome.close),
        "gain": gains,
        "torque_peak": float(outcome.peak.max()),
        "torque_rms": _quartiles(outcome.rms),
        "speed": _quartiles(outcome.speed),
        "turns": _quartiles(outcome.turns),
        "seconds_per_action": outcome.seconds_per_action,
    }


def _against(statistic: Statistic, policy: Array, base: Array) -> JSON:
    low, high = interval(statistic, policy, base)
    return {"ratio": _finite(statistic(policy, base)), "low": _finite(low), "high": _finite(high)}


def _quartiles(values: Array) -> list[float | None]:
    """Lower quartile, median, upper quartile."""
    return [_finite(value) for value in np.quantile(values, [0.25, 0.5, 0.75], method="closest_observation")]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
