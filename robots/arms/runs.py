"""Runs of simulated arms that follow a chosen motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.progress import Progress
from pendulum_env._typing import Array
from pendulum_env.backends.simulated import TORQUE_NOISE
from pendulum_env.excitation import LARGEST_TORQUE
from pendulum_env.policy import Policy
from pendulum_env.simulated_robot import PlannedRun, SimulatedRobot
from robots.arms.body import Body, BodyError
from robots.arms.design_env import plan_motion
from robots.arms.env import PlanarArm, SimulatedArm, SpatialArm
from robots.arms.excitation import design_excitation
from robots.arms.following import follow
from robots.arms.limits import find_limits
from robots.arms.plane import find_planar_links
from robots.arms.recording import ArmRecording
from robots.arms.reference import Reference


@dataclass(frozen=True, eq=False)
class ArmRun(PlannedRun):
    """Motion that a simulated arm follows."""

    arm: SimulatedArm
    motion: Reference

    def __str__(self) -> str:
        return str(self.motion)

    @property
    def condition(self) -> float:
        """Return the condition number of the regressor of the motion."""
        return self.motion.condition

    def compute_positions(self, time: Array) -> Array:
        """Compute the positions of the reference (N, n) [rad] or [m] at N instants [s]."""
        return self.motion(time)[0]

    def record(
        self, samples: int, max_torque: float | None, rng: np.random.Generator, name: str, progress: Progress
    ) -> ArmRecording:
        """Record the arm that follows the motion; see `follow`."""
        return follow(self.arm, self.motion, samples, max_torque, rng=rng, name=name, progress=progress)


@dataclass(frozen=True, eq=False)
class SimulatedBody(SimulatedRobot):
    """Simulated arm with its links."""

    body: Body
    arm: SimulatedArm

    def plan_run(
        self,
        seconds: float,
        rng: np.random.Generator,
        policy: Policy | None = None,
        *,
        max_angle: float | None = None,
        max_speed: float | None = None,
        max_torque: float | None = None,
    ) -> ArmRun:
        """Choose a motion by a policy, see `plan_motion`, or by `design_excitation` without one."""
        limits = {"max_angle": max_angle, "max_speed": max_speed, "max_torque": max_torque}
        if policy is not None:
            motion = plan_motion(policy, self.body, find_limits(self.body, **limits), seconds)
        else:
            motion = design_excitation(self.body, seconds, **limits, rng=rng)
        return ArmRun(self.arm, motion)


def simulate_body(
    body: Body, rate: float, counts: int, effects: Sequence[str], backend: str | None = None
) -> SimulatedBody:
    """Simulate an arm in pymunk if all joints turn in one vertical plane, else or on request in MuJoCo."""
    sensors: dict[str, Any] = {"rate": rate, "counts": counts, "effects": effects}
    sensors |= {"torque_noise": TORQUE_NOISE, "max_torque": LARGEST_TORQUE}
    if backend != "mujoco":
        try:
            links = find_planar_links(body)
            steps = max(1, round(1000.0 / rate))  # simulate at 1000 Hz or more
            # the controller gets exact velocities
            arm = PlanarArm(links, joints=body.joints, substeps=steps, velocity="ideal", **sensors)
            return SimulatedBody(body, arm)
        except BodyError:
            if backend is not None:
                raise
    return SimulatedBody(body, SpatialArm(body, **sensors))
