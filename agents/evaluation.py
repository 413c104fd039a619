"""Errors of the online estimator while a policy excites pendulums.

The information is the sum of outer products of the regressor rows of the estimator at 1 kHz, without the rows near
stick. It differs from the reward of the policy.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from agents.baselines import compute_regressor_rows
from agents.contenders import Contender
from agents.design_env import RATE, ExcitationDesignVector
from agents.observer import N_PARAMETERS, NOMINAL, TICK, compute_log_det
from estimators.online import OnlineEstimator
from estimators.schemes.six import SCHEMES, scheme
from pendulum_env._typing import Array, Mask
from pendulum_env.backends.sensing import COUNTS
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.physics import BASE, simulate
from pendulum_env.plant import PAPER
from pendulum_env.policy import State

REPORT_TIMES = (2.0, 5.0, 10.0)  # [s] at which errors are compared
LIMITS = ("angle", "speed", "torque")  # of the task, whose excesses are counted
ACCURACIES = (0.01, 0.003)  # bounds of the relative errors of all parameters
TICKS_REPORTED = [round(moment / TICK) - 1 for moment in REPORT_TIMES]
SEED_OFFSET = 2**20  # added to seeds, so that no training has drawn the plants


@dataclass(frozen=True, eq=False)
class Outcome:
    """Motion and errors of N plants under a policy, over T ticks of 20 ms.

    The Cramer-Rao bound holds for unbiased estimators that know the law and the exact motion, and use the samples in
    motion. It is NaN where effects are hidden.
    """

    parameter_errors: Array  # (T, N, P), relative errors of inertia, gravity, viscous and dry friction
    log_det: Array  # (T, N), of the information in nominal units [nat]
    bound: Array  # (M, N), Cramer-Rao bound of `error` at `REPORT_TIMES`
    torque: Array  # (T, N), commanded [N m]
    position: Array  # (T, N), at the end of each tick [rad]
    speed: Array  # (N,), largest |q'| [rad/s]
    action: Array  # (N,), largest |action| of the policy [share of the peak torque], before it is clipped to 1
    scheme_errors: Array  # (M, S, N), RMS error at `REPORT_TIMES` by each of the six schemes
    violated: Mask  # (T, N, 3), ticks beyond the `LIMITS` of the constraint; a requested torque beyond its limit counts
    seconds_per_action: float  # computing time of the policy for all plants [s]

    @cached_property
    def error(self) -> Array:
        """Compute the RMS of the relative errors of the parameters (T, N)."""
        return np.sqrt((self.parameter_errors**2).mean(axis=2))

    @cached_property
    def errors(self) -> Array:
        """Return the RMS error at `REPORT_TIMES` (M, N)."""
        return self.error[TICKS_REPORTED]

    @cached_property
    def close(self) -> Array:
        """Find the time after which all parameters stay within `ACCURACIES` (C, N) [s]; inf without one."""
        worst = np.abs(self.parameter_errors).max(axis=2)
        return np.array([find_settling_time(worst, bound) for bound in ACCURACIES])

    @staticmethod
    def join(parts: Sequence[Outcome]) -> Outcome:
        """Join the outcomes of one policy on several groups of plants."""
        arrays = [field.name for field in fields(Outcome) if field.name != "seconds_per_action"]
        axes = {"parameter_errors": 1, "violated": 1}  # axis of the plants; the last one of other arrays
        joint = {name: np.concatenate([getattr(p, name) for p in parts], axis=axes.get(name, -1)) for name in arrays}
        return Outcome(**joint, seconds_per_action=sum(part.seconds_per_action for part in parts))


def evaluate_policy(
    contender: Contender,
    constraint: str,
    plants: int,
    *,
    seed: int = 0,
    effects: Sequence[str] = (),
    spread: float = 0.3,
    scheme_id: str = "filtered_dynamic",
) -> Outcome:
    """Excite new plants for 10 s with a policy, and estimate their parameters online at 1 kHz.

    The same seed gives the same plants and noise to every policy. `spread` is that of `ExcitationDesignVector`.
    """
    policy = contender(seed)
    env = ExcitationDesignVector(plants, constraint=constraint, effects=effects, spread=spread, start="rest")
    estimator = OnlineEstimator(RATE, BASE, SCHEMES, batch=plants, counts=COUNTS)
    chosen, limits = SCHEMES.index(scheme(scheme_id)), env.constraint
    observation, info = env.reset(seed=SEED_OFFSET + seed)
    truth = np.stack([info["plant"][name] for name in PAPER], axis=1)
    estimator.take(np.zeros(plants), info["positions"][:, 0], np.zeros(plants))
    steps, n_samples = env.observer.ticks, env.observer.samples_per_tick
    errors, violated = (
        np.empty((steps, plants, len(SCHEMES), N_PARAMETERS)),
        np.empty((steps, plants, len(LIMITS)), bool),
    )
    torque, position, log_dets = np.empty((3, steps, plants))
    speed, action_peak, information = np.zeros(plants), np.zeros(plants), np.zeros((plants, N_PARAMETERS, N_PARAMETERS))
    state: State = None
    seconds = 0.0
    for k in range(steps):
        start = time.thread_time()  # without the time of other workers
        action, state = policy.predict(observation, state, np.full(plants, k == 0), deterministic=True)
        seconds += time.thread_time() - start
        action_peak = np.maximum(action_peak, np.abs(action[:, 0]))
        observation, _, _, _, info = env.step(action)
        for j in range(n_samples):
            time_now = np.full(plants, (k * n_samples + j + 1) / RATE)
            estimates = estimator.take(time_now, info["positions"][:, j], info["torques"][:, j])
            row = estimates.regressor * NOMINAL
            information += row[:, :, None] * row[:, None, :]
        errors[k] = estimates.theta / truth[:, None] - 1.0
        torque[k], position[k], log_dets[k] = info["torque"], info["positions"][:, -1], compute_log_det(information)
        fastest = np.abs(np.diff(info["positions"])).max(axis=1) * RATE
        speed = np.maximum(speed, fastest)
        requested = limits.peak * action[:, 0]
        excesses = (
            np.abs(info["positions"]).max(axis=1) - limits.angle,
            fastest - limits.speed,
            np.abs(requested - torque[k]) - 1e-6 * limits.peak,
        )
        violated[k] = np.array(excesses).T > 0
    bound = np.full((len(REPORT_TIMES), plants), np.nan)
    if not effects:
        bound = compute_cramer_rao_bound(truth, np.repeat(torque, n_samples, axis=0))
    by_scheme = np.sqrt((errors[TICKS_REPORTED] ** 2).mean(axis=-1)).transpose(0, 2, 1)
    return Outcome(
        errors[:, :, chosen],
        log_dets,
        bound,
        torque,
        position,
        speed,
        action_peak,
        by_scheme,
        violated,
        seconds / steps,
    )


def compute_cramer_rao_bound(truth: Array, torque: Array) -> Array:
    """Compute the Cramer-Rao bound of the RMS relative error at `REPORT_TIMES` (M, N).

    The measured torque is phi theta plus white noise of variance s^2 during motion. The Fisher information is
    sum phi phi' / s^2, with rows phi of the exact motion under parameters (N, P) and torque at 1 kHz (T, N). The bound
    is infinite where the information is singular.
    """
    motion = simulate(BASE, truth.T, 1.0 / RATE, torque, 0.0, 0.0)
    moving = motion.velocity[1:] * motion.velocity[:-1] > 0
    phi = compute_regressor_rows(motion, 1.0 / RATE) * truth * moving[..., None]  # of relative parameters
    ends = [round(moment * RATE) for moment in REPORT_TIMES]
    parts = [np.einsum("tni,tnj->nij", phi[a:b], phi[a:b]) for a, b in zip([0, *ends], ends, strict=False)]
    information = np.cumsum(parts, axis=0)  # (M, N, P, P)
    is_known = np.linalg.matrix_rank(information, hermitian=True) == N_PARAMETERS
    variance = TORQUE_NOISE**2 * np.linalg.inv(np.where(is_known[..., None, None], information, np.eye(N_PARAMETERS)))
    return np.where(is_known, np.sqrt(np.trace(variance, axis1=-2, axis2=-1) / N_PARAMETERS), np.inf)


def find_settling_time(errors: Array, bound: float) -> Array:
    """Find the time after which errors (T, N) of each tick stay within a bound (N,) [s]; inf without one."""
    outside = errors > bound
    last = len(errors) - np.argmax(outside[::-1], axis=0)  # number of ticks up to the last one outside
    last = np.where(outside.any(axis=0), last, 0)
    return np.where(last == len(errors), np.inf, (last + 1) * TICK)
