"""Errors of the online estimator while a policy excites pendulums.

Information is the sum of outer products of the estimator's own regressor rows at 1 kHz, clear of stick by its own
guard. It is not the reward of the policy.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from agents.baselines import rows
from agents.contenders import Contender
from agents.design_env import RATE, ExcitationDesignVector
from agents.observer import COUNT, NOMINAL, TICK, log_det
from estimators.online import OnlineEstimator
from estimators.schemes.six import scheme
from pendulum_env._typing import Array
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.physics import BASE
from pendulum_env.physics.simulation import simulate
from pendulum_env.plant import PAPER
from pendulum_env.policy import State

MOMENTS = (2.0, 5.0, 10.0)  # [s] at which errors are compared
CLOSE = (0.01, 0.003)  # shares of its value that every parameter has to stay within
FRESH = 2**20  # added to seeds, for plants that no training has drawn


@dataclass(frozen=True, eq=False)
class Outcome:
    """Motion and errors of N plants under a policy, over T ticks of 20 ms.

    The Cramer-Rao bound holds for unbiased estimators that see the motion exactly, use it while the arm moves, and know
    the law; it is NaN where effects are hidden.
    """

    parameter_errors: Array  # (T, N, P), relative errors of inertia, gravity, viscous and dry friction
    log_det: Array  # (T, N), of the information in nominal units [nat]
    bound: Array  # (M, N), Cramer-Rao bound of `error` at `MOMENTS`
    torque: Array  # (T, N), commanded [N m]
    position: Array  # (T, N), at the end of each tick [rad]
    speed: Array  # (N,), largest |q'| [rad/s]
    action: Array  # (N,), largest |action| of the policy [share of the peak torque], before it is clipped to 1
    seconds_per_action: float  # computing time that the policy took for all plants together [s]

    @cached_property
    def error(self) -> Array:
        """RMS of the relative errors of the parameters (T, N)."""
        return np.sqrt((self.parameter_errors**2).mean(axis=2))

    @cached_property
    def errors(self) -> Array:
        """RMS error at `MOMENTS` (M, N)."""
        return self.error[[round(moment / TICK) - 1 for moment in MOMENTS]]

    @cached_property
    def close(self) -> Array:
        """Time from which on all parameters stay within each of `CLOSE` (C, N) [s]; inf if they do not."""
        worst = np.abs(self.parameter_errors).max(axis=2)
        return np.array([stays_within(worst, bound) for bound in CLOSE])

    @staticmethod
    def join(parts: Sequence[Outcome]) -> Outcome:
        """Join the outcomes of one policy on several lots of plants."""
        arrays = [field.name for field in fields(Outcome) if field.name != "seconds_per_action"]
        axes = {"parameter_errors": 1}  # of the plants; the last of the others
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts], axis=axes.get(name, -1)) for name in arrays
        }
        return Outcome(**joined, seconds_per_action=sum(part.seconds_per_action for part in parts))


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
    """Let a policy excite fresh plants for 10 s and estimate their parameters online at 1 kHz.

    The same seed gives the same plants and the same noise to every policy. Effects are hidden in the plants; `task` has
    further arguments of `ExcitationDesignVector`: `spread`, `max_speed` or `max_turns`.
    """
    policy = contender(seed)
    env = ExcitationDesignVector(plants, constraint=constraint, effects=effects, **(task or {}))  # type: ignore[arg-type]
    estimator = OnlineEstimator(RATE, BASE, [scheme(scheme_id)], batch=plants, counts=COUNTS)
    observation, info = env.reset(seed=FRESH + seed)
    truth = np.stack([info["plant"][name] for name in PAPER], axis=1)
    estimator.take(np.zeros(plants), info["positions"][:, 0], np.zeros(plants))
    steps, held = env.observer.ticks, env.observer.held
    errors = np.empty((steps, plants, COUNT))
    torque, position, learnt = np.empty((3, steps, plants))
    speed, asked, information = np.zeros(plants), np.zeros(plants), np.zeros((plants, COUNT, COUNT))
    state: State = None
    acting = 0.0
    for k in range(steps):
        begun = time.thread_time()  # what other workers do is not the policy's
        action, state = policy.predict(observation, state, np.full(plants, k == 0), deterministic=True)
        acting += time.thread_time() - begun
        asked = np.maximum(asked, np.abs(action[:, 0]))
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
    return Outcome(errors, learnt, bound, torque, position, speed, asked, acting / steps)


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
