"""Environments in which an agent chooses the motion of an arm: the speeds of all joints at the next knot.

The arm follows a `Reference` with its own controller, within limits of angle, speed and torque. The information of the
motion does not depend on the unknown parameters, so no simulation is needed, and `plan_motion` plans a whole motion in
advance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.observer import LOG_SCALE, OBSERVATION_BOUND, Batch
from agents.task import Task, TaskState, TaskVector
from estimators.regression.least_squares import IdentificationError
from pendulum_env._typing import Array
from pendulum_env.errors import UserError
from pendulum_env.excitation import DEFAULT_SPEED
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.policy import Policy, State
from robots.arms.body import Body, parse_body, read_body
from robots.arms.env import PlanarArm
from robots.arms.excitation import INFORMATION_PRIOR, MotionBatch, find_problem, stop_motion
from robots.arms.limits import DEFAULT_LIMITS, Limits, find_limits
from robots.arms.reference import KNOT_PERIOD, Reference

SECONDS = (2.0, 10.0)  # [s], range of the random duration of an episode
# Random factors of the limits
SHARES = {"angle": (0.2, 1.0), "speed": (0.3, 1.5), "torque": (0.8, 1.2), "acceleration": (0.7, 2.5)}
TORQUE = 12.0  # [N m], default bound of the torque
N_SAMPLED_MOTIONS = 256  # drawn from a policy; the best is used
TIME_SCALE = 5.0  # [s], divisor of the time left in the observation


def compute_observation(motions: MotionBatch, time_left: float) -> Batch:
    """Compute observations (B, 8 n + 2 P + 1) of motions at a knot with the time left [s]."""
    q, (low, high, speed, torque, acceleration) = motions.position, motions.limits
    information = np.log(motions.information.diagonal(axis1=1, axis2=2) / INFORMATION_PRIOR)
    uncertainty = -np.log(motions.variances * INFORMATION_PRIOR)
    motion = [np.sin(q), np.cos(q), (2 * q - low - high) / (high - low), motions.speed / speed]
    rise = speed / acceleration / DEFAULT_LIMITS.rise
    limits = [(high - low) / (2 * np.pi), speed / DEFAULT_SPEED, torque / TORQUE, rise]
    time = np.full((len(q), 1), time_left / TIME_SCALE)
    features = np.concatenate([*motion, *limits, information / LOG_SCALE, uncertainty / LOG_SCALE, time], axis=1)
    return np.clip(features, -OBSERVATION_BOUND, OBSERVATION_BOUND).astype(np.float32)


class ArmExcitationDesignVector(TaskVector):
    """B motions of an arm with unknown parameters; made by `gymnasium.make_vec`.

    Action (B, n): speeds of the joints at the next knot, 0.1 s later, as shares of the largest, in [-1, 1]. Limits of
    angle, speed and torque apply. Observation (B, 8 n + 2 P + 1): for each joint sin q, cos q, q and q' as shares of
    their limits, and these limits. Log information and log variance of base parameters and friction follow, then the
    time left.
    Reward: decrease of the log of the RMS standard error, relative to the parameters of the file [nat]. Episodes end
    together, after 2 to 10 s.

    `info` has `speed` at the knot (B, n), and `variances` (B,) by name of the parameter, relative to the parameters,
    for a noise of one on the mean torque of 20 ms.
    """

    @refuse_unknown_arguments
    def __init__(
        self,
        num_envs: int = 1,
        *,
        robot: str | None = None,
        seconds: float | None = None,
        max_angle: float | None = None,
        max_speed: float | None = None,
        max_torque: float | None = None,
        max_acceleration: float | None = None,
        draw: bool = False,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        """Make the environments.

        Args:
            num_envs: number B of motions.
            robot: file of the arm, URDF or MJCF; the links of `PlanarArm-v0` by default.
            seconds: duration of an episode [s]; random by default.
            max_angle: largest angle to either side of zero [rad]; the limit of the file applies, too.
            max_speed: largest speed [rad/s], 4 by default; the limit of the file applies, too.
            max_torque: largest torque of each joint [N m], 12 by default; the limit of the file applies, too.
            max_acceleration: largest acceleration [rad/s^2]; by default full speed is reached in 0.2 s.
            draw: draw random limits for each episode: 0.2 to 1 times these angles, 0.3 to 1.5 times these speeds, 0.8
                to 1.2 times these torques, full speed after 0.08 to 0.29 s.
            autoreset_mode: when the next episodes begin.

        Raises:
            ValueError: if an argument is out of its range, or the file is no robot.
        """
        if seconds is not None and not KNOT_PERIOD <= seconds < np.inf:
            raise UserError(f"an episode of {seconds:g} s is too short: give {KNOT_PERIOD:g} s or more")
        self.body = parse_body(PlanarArm().urdf) if robot is None else read_body(robot)
        torque = TORQUE if max_torque is None else max_torque
        self.body.refuse_impossible_links()
        self.limits = find_limits(self.body, max_angle, max_speed, torque, max_acceleration)
        self._seconds, self._draw = seconds, draw
        self._motions = MotionBatch(self.body, self.limits, num_envs)
        super().__init__(
            num_envs, compute_observation(self._motions, 1.0).shape[1], len(self.body.joints), autoreset_mode
        )

    def _begin_episodes(self, options: dict[str, Any]) -> TaskState:
        limits, rng = self.limits, self.np_random
        if self._draw:
            angle, speed, torque, acceleration = (rng.uniform(*share, (self.num_envs, 1)) for share in SHARES.values())
            home = np.clip(0.0, limits.low, limits.high)  # zero may be outside of the limits
            low, high = home + (limits.low - home) * angle, home + (limits.high - home) * angle
            limits = Limits(
                low, high, limits.speed * speed, limits.torque * torque, limits.acceleration * speed * acceleration
            )
        seconds = rng.uniform(*SECONDS) if self._seconds is None else self._seconds
        self._motions, self._steps_left = MotionBatch(self.body, limits, self.num_envs), round(seconds / KNOT_PERIOD)
        return self._make_state()

    def _apply_actions(self, shares: Array) -> TaskState:
        self._motions.advance(np.clip(shares, -1.0, 1.0))
        return self._make_state()

    def _make_state(self) -> TaskState:
        info = {"speed": self._motions.speed, "variances": self._name_variances()}
        return compute_observation(self._motions, self._steps_left * KNOT_PERIOD), self._motions.log_precision, info

    def _name_variances(self) -> dict[str, Any]:
        """Return the variances (B,) by name, with Gymnasium's masks."""
        friction = [f"{law}@{joint}" for law in ("viscous", "coulomb") for joint in self.body.joints]
        variances = dict(zip((*self.body.names, *friction), self._motions.variances.T, strict=True))
        return variances | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in variances}


class ArmExcitationDesign(Task):
    """One motion of an arm: `ArmExcitationDesignVector` with a batch of one, without the first axis."""

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        """Make the environment with the arguments of `ArmExcitationDesignVector`, without `num_envs`.

        Raises TypeError for a `render_mode` other than None; stable-baselines3 then leaves it out.
        """
        if render_mode is not None:
            raise TypeError(f"render_mode is {render_mode!r}: leave it out, this environment draws no pictures")
        super().__init__(ArmExcitationDesignVector(1, **arguments))


def plan_motion(policy: Policy, body: Body, limits: Limits, seconds: float) -> Reference:
    """Plan the motion of an arm with a policy.

    `N_SAMPLED_MOTIONS` motions are drawn from the policy, and the best within the limits is returned. It ends at rest
    after `seconds`. The torque is limited to 12 N m, as in training. A policy was trained with `SHARES` of the default
    limits and with durations of `SECONDS`; outside of these it may be worse than a random motion.

    Raises:
        ValueError: if the policy was trained for another number of joints or parameters.
        IdentificationError: if each motion needs more torque than allowed, or leaves a joint at rest.
    """
    limits = limits._replace(torque=np.minimum(limits.torque, TORQUE))
    motions = MotionBatch(body, limits, N_SAMPLED_MOTIONS)
    state: State = (np.random.default_rng(0),)
    start, speeds = motions.position[0], [motions.speed]
    for steps_left in range(round(seconds / KNOT_PERIOD), 0, -1):
        begins = np.full(N_SAMPLED_MOTIONS, len(speeds) == 1)
        action, state = policy.predict(
            compute_observation(motions, steps_left * KNOT_PERIOD), state, begins, deterministic=False
        )
        motions.advance(np.clip(np.asarray(action, dtype=float), -1.0, 1.0))
        speeds.append(motions.speed)
    reason = ""
    for best in np.argsort(-motions.log_precision)[:, None]:
        motion = stop_motion(body, motions.select(best), start, [speed[best] for speed in speeds])
        if not (problem := find_problem(motion, limits)):
            return motion
        reason = reason or problem
    raise IdentificationError(f"{body.name}: under the policy {reason}")
