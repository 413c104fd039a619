"""Choosing the motion of an arm as a task: the speeds of all joints at the next knot, paid for what the motion teaches.

The arm follows a `Reference` by its own controller, within limits of angle, speed and torque. What such a motion
teaches does not depend on the parameters that are to be learnt, so nothing has to be simulated to choose it, and a
policy plays the whole motion in advance: `plan`.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agents.design_env import single
from agents.knowledge import DECADES
from agents.observer import BOUND, Batch
from estimators.arms.excitation import PRIOR, Moving, objection, to_rest
from estimators.arms.limits import Limits, limits_of
from estimators.arms.reference import HOLD, Reference
from estimators.regression.equations import IdentificationError
from estimators.wrappers.options import body_in
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body, read_body
from pendulum_env.arms.env import PlanarArm
from pendulum_env.excitation import USUAL_SPEED
from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.policy import Policy, State

SECONDS = (2.0, 10.0)  # length of an episode, where nobody says
SHARES = {"angle": (0.2, 1.0), "speed": (0.3, 1.5), "torque": (0.8, 1.2)}  # of the limits, likewise
TORQUE = 12.0  # [N m], the bound where neither file nor argument has one
PACE = 5.0  # [s], by which the time left is divided in the observation

Bools = NDArray[np.bool_]


def observe(moving: Moving, left: float) -> Batch:
    """Observations (B, 7 n + 2 P + 1) of motions at a knot, with so much time left [s]."""
    q, (low, high, speed, torque, _) = moving.position, moving.limits
    own = np.log(moving.information.diagonal(axis1=1, axis2=2) / PRIOR)
    known = -np.log(moving.variances * PRIOR)
    where = [np.sin(q), np.cos(q), (2 * q - low - high) / (high - low), moving.speed / speed]
    limits = [(high - low) / (2 * np.pi), speed / USUAL_SPEED, torque / TORQUE]
    time = np.full((len(q), 1), left / PACE)
    seen = np.concatenate([*where, *limits, own / DECADES, known / DECADES, time], axis=1)
    return np.clip(seen, -BOUND, BOUND).astype(np.float32)


class ArmExcitationDesignVector(VectorEnv[Batch, Batch, Array]):
    """B motions of an arm whose parameters are to be learnt; made by `gymnasium.make_vec`.

    Action (B, n): speeds of the joints at the next knot, 0.1 s later, as shares of the largest, in [-1, 1]; they are
    reached as far as limits of angle, speed and torque allow. Observation (B, 7 n + 2 P + 1): of the joints sin q,
    cos q, q and q' as shares of their limits, and these limits; log information and log variance of base parameters and
    friction; the time left. Reward: by how much the log of the RMS standard error, relative to the parameters of the
    file, falls [nat]. Episodes end together, after 2 to 10 s.

    `info`: `speed` at the knot (B, n), `variances` as shares of the parameters and for a noise of one on the mean
    torque of 20 ms (B, P).
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        robot: str | None = None,
        seconds: float | None = None,
        max_angle: float | None = None,
        max_speed: float | None = None,
        max_torque: float | None = None,
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
            draw: whether each episode has limits of its own: 0.2 to 1 times these angles, 0.3 to 1.5 times these
                speeds, 0.8 to 1.2 times these torques.
            autoreset_mode: as of the pendulums.

        Raises:
            ValueError: if an argument is out of its range, or the file is no robot.
        """
        if seconds is not None and not HOLD <= seconds < np.inf:
            raise Mistake(f"an episode cannot last {seconds:g} s: give {HOLD:g} s or more")
        self.body = body_in(PlanarArm()) if robot is None else read_body(robot)
        self.limits = limits_of(self.body, max_angle, max_speed, TORQUE if max_torque is None else max_torque)
        self.num_envs, self.render_mode, self._seconds, self._draw = num_envs, None, seconds, draw
        self.autoreset = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset}
        self._moving, self._left = Moving(self.body, self.limits, num_envs), 0
        inputs = observe(self._moving, 1.0).shape[1]
        self.single_observation_space = gym.spaces.Box(-BOUND, BOUND, (inputs,), dtype=np.float32)
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (len(self.body.joints),), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Batch, dict[str, Any]]:
        """Begin motions at rest; the seed draws limits and length."""
        super().reset(seed=seed[0] if isinstance(seed, list) else seed)
        for name in options or {}:
            find("option of reset", name, {})
        return self._begin()

    def _begin(self) -> tuple[Batch, dict[str, Any]]:
        limits, rng = self.limits, self.np_random
        if self._draw:
            angle, speed, torque = (rng.uniform(*share, (self.num_envs, 1)) for share in SHARES.values())
            home = np.clip(0.0, limits.low, limits.high)  # zero may be none of their positions
            low, high = home + (limits.low - home) * angle, home + (limits.high - home) * angle
            limits = Limits(low, high, limits.speed * speed, limits.torque * torque, limits.acceleration * speed)
        seconds = rng.uniform(*SECONDS) if self._seconds is None else self._seconds
        self._moving, self._left = Moving(self.body, limits, self.num_envs), round(seconds / HOLD)
        return self._look()

    def _look(self) -> tuple[Batch, dict[str, Any]]:
        everyone = np.ones(self.num_envs, dtype=bool)
        info = {"speed": self._moving.speed, "variances": self._moving.variances}
        return observe(self._moving, self._left * HOLD), info | {f"_{name}": everyone for name in info}

    def step(  # type: ignore[override]  # Gymnasium types the flags like the rewards
        self, actions: Batch
    ) -> tuple[Batch, Array, Bools, Bools, dict[str, Any]]:
        """Go on to the next knot with shares of the largest speeds (B, n).

        Raises:
            ValueError: if an action is no number, or there is not one for each joint.
        """
        shares = np.asarray(actions, dtype=float)
        if shares.shape != self.action_space.shape or not np.isfinite(shares).all():
            raise ValueError(f"actions are {self.action_space.shape} numbers, not {actions}")
        nobody = np.zeros(self.num_envs, dtype=bool)
        if self._left <= 0 and self.autoreset is AutoresetMode.NEXT_STEP:
            observation, info = self._begin()
            return observation, np.zeros(self.num_envs), nobody, nobody.copy(), info
        before = self._moving.worth
        self._moving.go(np.clip(shares, -1.0, 1.0))
        self._left -= 1
        reward = self._moving.worth - before
        truncated = np.full(self.num_envs, self._left <= 0)
        observation, info = self._look()
        if self._left <= 0 and self.autoreset is AutoresetMode.SAME_STEP:
            final = {"final_obs": observation, "_final_obs": truncated, "final_info": info, "_final_info": truncated}
            observation, info = self._begin()
            info |= final
        return observation, reward, nobody, truncated, info


class ArmExcitationDesign(gym.Env[Batch, Batch]):
    """One motion of an arm: `ArmExcitationDesignVector` with a batch of one, without its first axis."""

    metadata = {"render_modes": []}  # noqa: RUF012  (Gymnasium's own interface)

    def __init__(self, **arguments: Any) -> None:
        """Make it; the arguments are those of the batch but for the number of motions."""
        self._batch = ArmExcitationDesignVector(1, **arguments)
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Batch, dict[str, Any]]:
        """Begin a motion at rest."""
        super().reset(seed=seed)
        observation, info = self._batch.reset(seed=seed, options=options)
        return observation[0], single(info)

    def step(self, action: Batch) -> tuple[Batch, float, bool, bool, dict[str, Any]]:
        """Go on to the next knot with shares of the largest speeds (n,)."""
        observation, reward, _, truncated, info = self._batch.step(np.asarray(action)[None])
        return observation[0], float(reward[0]), False, bool(truncated[0]), single(info)


def plan(policy: Policy, body: Body, limits: Limits, seconds: float) -> Reference:
    """The motion that a policy chooses for an arm within limits; after `seconds` the arm is brought to rest.

    A policy knows nothing of the arm but what it observes: one of as many joints and parameters is not told from that
    which it was trained for. It has learnt `SHARES` of the usual limits, and motions of `SECONDS`; beyond, it may do
    worse than chance. Torque is bounded as in its training, by 12 N m where nobody says less.

    Raises:
        ValueError: if the policy was trained for an arm of other numbers of joints or parameters.
        IdentificationError: if its motion needs more torque than there is, or a joint never moves.
    """
    limits = limits._replace(torque=np.minimum(limits.torque, TORQUE))
    moving = Moving(body, limits, 1)
    state: State = None
    start, speeds = moving.position[0], [moving.speed]
    for left in range(round(seconds / HOLD), 0, -1):
        action, state = policy.predict(observe(moving, left * HOLD), state, np.array([len(speeds) == 1]), True)
        moving.go(np.clip(np.asarray(action, dtype=float), -1.0, 1.0))
        speeds.append(moving.speed)
    motion = to_rest(body, moving, start, speeds)
    if told := objection(motion, limits):
        raise IdentificationError(f"{body.name}: under the policy {told}")
    return motion
