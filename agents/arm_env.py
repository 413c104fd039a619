"""Choosing the motion of an arm as a task: the speeds of all joints at the next knot, paid for what the motion teaches.

The arm follows a `Reference` by its own controller, within limits of angle, speed and torque. What such a motion
teaches does not depend on the parameters that are to be learnt, so nothing has to be simulated to choose it, and a
policy plays the whole motion in advance: `plan`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.observer import BOUND, DECADES, Batch
from agents.task import Seen, Task, TaskVector
from estimators.arms.excitation import PRIOR, Moving, objection, to_rest
from estimators.arms.limits import USUAL, Limits, limits_of
from estimators.arms.reference import HOLD, Reference
from estimators.regression.equations import IdentificationError
from estimators.wrappers.options import body_in
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.env import PlanarArm
from pendulum_env.excitation import USUAL_SPEED
from pendulum_env.lookup import with_known_arguments
from pendulum_env.mistake import Mistake
from pendulum_env.policy import Policy, State

SECONDS = (2.0, 10.0)  # length of an episode, where nobody says
SHARES = {"angle": (0.2, 1.0), "speed": (0.3, 1.5), "torque": (0.8, 1.2), "acceleration": (0.7, 2.5)}  # of the limits
TORQUE = 12.0  # [N m], the bound where neither file nor argument has one
PLAYS = 256  # of a policy, of which the best is taken
PACE = 5.0  # [s], by which the time left is divided in the observation


def observe(moving: Moving, left: float) -> Batch:
    """Observations (B, 8 n + 2 P + 1) of motions at a knot, with so much time left [s]."""
    q, (low, high, speed, torque, acceleration) = moving.position, moving.limits
    own = np.log(moving.information.diagonal(axis1=1, axis2=2) / PRIOR)
    known = -np.log(moving.variances * PRIOR)
    where = [np.sin(q), np.cos(q), (2 * q - low - high) / (high - low), moving.speed / speed]
    rise = speed / acceleration / USUAL.rise
    limits = [(high - low) / (2 * np.pi), speed / USUAL_SPEED, torque / TORQUE, rise]
    time = np.full((len(q), 1), left / PACE)
    seen = np.concatenate([*where, *limits, own / DECADES, known / DECADES, time], axis=1)
    return np.clip(seen, -BOUND, BOUND).astype(np.float32)


class ArmExcitationDesignVector(TaskVector):
    """B motions of an arm whose parameters are to be learnt; made by `gymnasium.make_vec`.

    Action (B, n): speeds of the joints at the next knot, 0.1 s later, as shares of the largest, in [-1, 1]; they are
    reached as far as limits of angle, speed and torque allow. Observation (B, 8 n + 2 P + 1): of the joints sin q,
    cos q, q and q' as shares of their limits, and these limits; log information and log variance of base parameters and
    friction; the time left. Reward: by how much the log of the RMS standard error, relative to the parameters of the
    file, falls [nat]. Episodes end together, after 2 to 10 s.

    `info`: `speed` at the knot (B, n), `variances` as shares of the parameters and for a noise of one on the mean
    torque of 20 ms (B, P).
    """

    @with_known_arguments
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
            seconds: length of an episode; drawn anew for each by default.
            max_angle: to either side of zero [rad], if less than the file's.
            max_speed: [rad/s], if less than the file's; 4 by default.
            max_torque: of every joint [N m], if less than the file's; 12 by default.
            max_acceleration: [rad/s^2]; by default full speed takes 0.2 s.
            draw: whether each episode has limits of its own: 0.2 to 1 times these angles, 0.3 to 1.5 times these
                speeds, 0.8 to 1.2 times these torques, full speed after 0.08 to 0.29 s.
            autoreset_mode: as of the pendulums.

        Raises:
            ValueError: if an argument is out of its range, or the file is no robot.
        """
        if seconds is not None and not HOLD <= seconds < np.inf:
            raise Mistake(f"an episode cannot last {seconds:g} s: give {HOLD:g} s or more")
        self.body = body_in(PlanarArm()) if robot is None else read_body(robot)
        torque = TORQUE if max_torque is None else max_torque
        self.body.refuse_impossible_links()
        self.limits = limits_of(self.body, max_angle, max_speed, torque, max_acceleration)
        self._seconds, self._draw = seconds, draw
        self._moving = Moving(self.body, self.limits, num_envs)
        super().__init__(num_envs, observe(self._moving, 1.0).shape[1], len(self.body.joints), autoreset_mode)

    def _begin(self, options: dict[str, Any]) -> Seen:
        limits, rng = self.limits, self.np_random
        if self._draw:
            angle, speed, torque, acceleration = (rng.uniform(*share, (self.num_envs, 1)) for share in SHARES.values())
            home = np.clip(0.0, limits.low, limits.high)  # zero may be none of their positions
            low, high = home + (limits.low - home) * angle, home + (limits.high - home) * angle
            limits = Limits(
                low, high, limits.speed * speed, limits.torque * torque, limits.acceleration * speed * acceleration
            )
        seconds = rng.uniform(*SECONDS) if self._seconds is None else self._seconds
        self._moving, self._left = Moving(self.body, limits, self.num_envs), round(seconds / HOLD)
        return self._seen()

    def _go(self, shares: Array) -> Seen:
        self._moving.go(np.clip(shares, -1.0, 1.0))
        return self._seen()

    def _seen(self) -> Seen:
        info = {"speed": self._moving.speed, "variances": self._moving.variances}
        return observe(self._moving, self._left * HOLD), self._moving.worth, info


class ArmExcitationDesign(Task):
    """One motion of an arm: `ArmExcitationDesignVector` with a batch of one, without its first axis."""

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(self, **arguments: Any) -> None:
        """Make it; the arguments are those of the batch but for the number of motions."""
        super().__init__(ArmExcitationDesignVector(1, **arguments))


def plan(policy: Policy, body: Body, limits: Limits, seconds: float) -> Reference:
    """The motion that a policy chooses for an arm, of many that it draws by its odds the best within limits.

    After `seconds` it is brought to rest. A policy knows nothing of the arm but what it observes: one of as many joints
    and parameters is not told from that which it was trained for. It has learnt `SHARES` of the usual limits, and
    motions of `SECONDS`; beyond, it may do worse than chance. Nobody gets more torque than in training, 12 N m.

    Raises:
        ValueError: if the policy was trained for an arm of other numbers of joints or parameters.
        IdentificationError: if its motion needs more torque than there is, or a joint never moves.
    """
    limits = limits._replace(torque=np.minimum(limits.torque, TORQUE))
    moving = Moving(body, limits, PLAYS)
    state: State = (np.random.default_rng(0),)
    start, speeds = moving.position[0], [moving.speed]
    for left in range(round(seconds / HOLD), 0, -1):
        begins = np.full(PLAYS, len(speeds) == 1)
        action, state = policy.predict(observe(moving, left * HOLD), state, begins, deterministic=False)
        moving.go(np.clip(np.asarray(action, dtype=float), -1.0, 1.0))
        speeds.append(moving.speed)
    told = ""
    for best in np.argsort(-moving.worth)[:, None]:
        motion = to_rest(body, moving.chosen(best), start, [speed[best] for speed in speeds])
        if not (against := objection(motion, limits)):
            return motion
        told = told or against
    raise IdentificationError(f"{body.name}: under the policy {told}")
