"""How much sooner an excitation makes the parameters known: policies on the same plants, the real estimator beside.

What counts is the real error of the real estimator. Information is the sum of outer products of its own regressor rows
at 1 kHz, clear of stick by its own guard, not what the policy was paid for.
"""

from __future__ import annotations

import operator
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any

import numpy as np

from agents.baselines import rows
from agents.design_env import RATE, ExcitationDesignVector
from agents.observer import COUNT, NOMINAL, TICK, log_det
from estimators.online import OnlineEstimator
from estimators.progress import Progress
from estimators.schemes.six import scheme
from pendulum_env._typing import JSON, Array
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.physics import BASE
from pendulum_env.physics.simulation import simulate
from pendulum_env.policy import Policy, State

SCHEMA = "pendulum-ident/evaluation@2"
MOMENTS = (2.0, 5.0, 10.0)  # [s] at which errors are told
CLOSE = (0.01, 0.003)  # shares of its value that every parameter has to stay within
RESAMPLES = 2000
FRESH = 2**20  # added to seeds, for plants that no training has drawn
PART = 160  # plants at most that are simulated together; how many workers there are changes nothing
Statistic = Callable[[Array, Array], float]
Contender = Callable[[int], Policy]  # makes a policy from the seed of what it draws


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a policy did and what was learnt, on N plants over T ticks of 20 ms.

    The Cramer-Rao bound is of unbiased estimators that see the motion exactly, use it while the arm moves, and know the
    law; it is NaN where effects are hidden.
    """

    error: Array  # (T, N), RMS of the relative errors of the four parameters
    worst: Array  # (T, N), largest of them
    log_det: Array  # (T, N), of the information in nominal units [nat]
    bound: Array  # (M, N), Cramer-Rao bound of `error` at `MOMENTS`
    torque: Array  # (T, N), commanded [N m]
    position: Array  # (T, N), at the end of each tick [rad]
    speed: Array  # (N,), largest |q'| [rad/s]
    seconds_per_action: float  # computing time that the policy took for all plants together [s]

    @cached_property
    def errors(self) -> Array:
        """RMS error at `MOMENTS` (M, N)."""
        return self.error[[round(moment / TICK) - 1 for moment in MOMENTS]]

    @cached_property
    def close(self) -> Array:
        """Time from which on all four stay within each of `CLOSE` (C, N) [s]; inf if they do not."""
        return np.array([stays_within(self.worst, bound) for bound in CLOSE])

    @staticmethod
    def join(parts: Sequence[Outcome]) -> Outcome:
        """Outcomes of one policy on several lots of plants, as one."""
        arrays = [field.name for field in fields(Outcome) if field.name != "seconds_per_action"]
        joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in arrays}
        return Outcome(**joined, seconds_per_action=sum(part.seconds_per_action for part in parts))


def compare(
    contenders: Mapping[str, Contender],
    constraint: str,
    plants: int,
    *,
    seed: int = 0,
    executor: Executor | None = None,
    tell: Progress | None = None,
    **setting: Any,
) -> dict[str, Outcome]:
    """Let every policy excite the same fresh plants for 10 s.

    The result depends on the seed, not on where it is worked out.

    Args:
        contenders: functions of a seed by name, picklable if there is an executor.
        constraint: of the torque.
        plants: number of them.
        seed: of plants, noise and signals.
        executor: processes that do the work; None does it here.
        tell: called with the progress, as text and as a share.
        setting: of all, see `observe`.
    """
    sizes = [min(PART, plants - first) for first in range(0, plants, PART)]
    jobs = [
        partial(observe, contender, constraint, size, seed=seed + 4 * FRESH * part, **setting)
        for contender in contenders.values()
        for part, size in enumerate(sizes)
    ]
    work: Callable[..., Iterable[Outcome]] = map if executor is None else executor.map
    done: list[Outcome] = []
    for outcome in work(operator.call, jobs):
        done.append(outcome)
        if tell is not None:
            tell([*contenders][(len(done) - 1) // len(sizes)], len(done) / len(jobs))
    count = len(sizes)
    return {name: Outcome.join(done[k * count : (k + 1) * count]) for k, name in enumerate(contenders)}


def observe(
    contender: Contender,
    constraint: str,
    plants: int,
    *,
    seed: int = 0,
    effects: Sequence[str] = (),
    task: Mapping[str, float] | None = None,
    scheme_id: str = "filtered_dynamic",
) -> Outcome:
    """Let a policy excite fresh plants for 10 s, the online estimator beside it at 1 kHz.

    The same seed gives the same plants and the same noise to every policy. Effects are hidden in the plants; `task` has
    further arguments of `ExcitationDesignVector`: `spread`, `max_speed` or `max_turns`.
    """
    policy = contender(seed)
    env = ExcitationDesignVector(plants, constraint=constraint, effects=effects, **(task or {}))  # type: ignore[arg-type]
    estimator = OnlineEstimator(RATE, BASE, [scheme(scheme_id)], batch=plants)
    observation, info = env.reset(seed=FRESH + seed)
    truth = info["plant"][:, :COUNT]
    estimator.take(np.zeros(plants), info["positions"][:, 0], np.zeros(plants))
    steps, held = env.observer.ticks, env.observer.held
    errors = np.empty((steps, plants, COUNT))
    torque, position, learnt = np.empty((3, steps, plants))
    speed, information = np.zeros(plants), np.zeros((plants, COUNT, COUNT))
    state: State = None
    acting = 0.0
    for k in range(steps):
        begun = time.thread_time()  # what other workers do is not the policy's
        action, state = policy.predict(observation, state, np.full(plants, k == 0), deterministic=True)
        acting += time.thread_time() - begun
        observation, _, _, _, info = env.step(action)
        for j in range(held):
            now = np.full(plants, (k * held + j + 1) / RATE)
            known = estimator.take(now, info["positions"][:, j], info["torques"][:, j])
            row = known.regressor * NOMINAL
            information += row[:, :, None] * row[:, None, :]
        errors[k] = known.theta[:, 0] / truth - 1.0
        torque[k], position[k], learnt[k] = info["torque"], info["positions"][:, -1], log_det(information)
        speed = np.maximum(speed, np.abs(np.diff(info["positions"])).max(axis=1) * RATE)
    bound = np.full((len(MOMENTS), plants), np.nan)
    if not effects:
        bound = cramer_rao(truth, np.repeat(torque, held, axis=0))
    error, worst = np.sqrt((errors**2).mean(axis=2)), np.abs(errors).max(axis=2)
    return Outcome(error, worst, learnt, bound, torque, position, speed, acting / steps)


def cramer_rao(truth: Array, torque: Array) -> Array:
    """Least RMS relative error of parameters (N, P) at `MOMENTS` (M, N), under torques at 1 kHz (T, N).

    The measured torque is phi theta plus white noise of variance s^2 while the arm moves: Fisher's information is
    sum phi phi' / s^2, with rows phi of the exact motion. Infinite where that is singular.
    """
    way = simulate(BASE, truth.T, 1.0 / RATE, torque, 0.0, 0.0)
    moving = way.velocity[1:] * way.velocity[:-1] > 0
    phi = rows(way, 1.0 / RATE) * truth * moving[..., None]  # of relative parameters
    ends = [round(moment * RATE) for moment in MOMENTS]
    parts = [np.einsum("tni,tnj->nij", phi[a:b], phi[a:b]) for a, b in zip([0, *ends], ends, strict=False)]
    information = np.cumsum(parts, axis=0)  # (M, N, P, P)
    known = np.linalg.matrix_rank(information, hermitian=True) == COUNT
    variance = TORQUE_NOISE**2 * np.linalg.inv(np.where(known[..., None, None], information, np.eye(COUNT)))
    return np.where(known, np.sqrt(np.trace(variance, axis1=-2, axis2=-1) / COUNT), np.inf)


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


def evaluation_json(outcomes: Mapping[str, Outcome], base: str, **setting: object) -> JSON:
    """All policies beside a baseline, for programs, and what else is to be written; the infinite or unknown is null."""
    policies = {name: _policy_json(outcome, outcomes[base]) for name, outcome in outcomes.items()}
    return {"schema": SCHEMA, **setting, "baseline": base, "policies": policies}


def _policy_json(outcome: Outcome, base: Outcome) -> JSON:
    moments, bounds = [f"{moment:g} s" for moment in MOMENTS], [f"{100 * bound:g} %" for bound in CLOSE]
    names = [f"error {moment}" for moment in moments] + [f"time to {bound}" for bound in bounds]
    series = zip(names, [*outcome.errors, *outcome.close], [*base.errors, *base.close], strict=True)
    gains = {name: _against(improvement, own, usual) for name, own, usual in series}
    gains["information"] = _against(information_ratio, outcome.log_det[-1], base.log_det[-1])
    return {
        "error": dict(zip(moments, map(_quartiles, outcome.errors), strict=True)),
        "cramer_rao": dict(zip(moments, map(_quartiles, outcome.bound), strict=True)),
        "time_to": dict(zip(bounds, map(_quartiles, outcome.close), strict=True)),
        "gain": gains,
        "torque_peak": float(np.abs(outcome.torque).max()),
        "torque_rms": _quartiles(np.sqrt((outcome.torque**2).mean(axis=0))),
        "speed": _quartiles(outcome.speed),
        "turns": _quartiles(np.ptp(outcome.position, axis=0) / (2 * np.pi)),  # between the outermost angles
        "seconds_per_action": outcome.seconds_per_action,
    }


def _against(statistic: Statistic, policy: Array, base: Array) -> JSON:
    values = statistic(policy, base), *interval(statistic, policy, base)
    return dict(zip(("ratio", "low", "high"), map(_finite, values), strict=True))


def _quartiles(values: Array) -> list[float | None]:
    """Lower quartile, median, upper quartile."""
    return [_finite(value) for value in np.quantile(values, [0.25, 0.5, 0.75], method="closest_observation")]


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
