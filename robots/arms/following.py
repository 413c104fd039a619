"""Simulation of an arm that follows a designed motion with a controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np

from estimators.progress import Progress, no_progress
from pendulum_env._typing import Array
from pendulum_env.policy import collect_samples, iterate_steps
from robots.arms.env import SimulatedArm
from robots.arms.plane import get_friction
from robots.arms.recording import ArmRecording
from robots.arms.reference import Reference

BANDWIDTH = 30.0  # [rad/s]; fast against the motion, slow against samples of some milliseconds


@dataclass(frozen=True, eq=False)
class Follow:
    """Computed-torque controller with critical damping.

        tau = Y(q, q', a) theta + b q_r' + fc sgn q_r',    a = q_r'' + 2 w (q_r' - q') + w^2 (q_r - q)

    Links and friction are those of the file. Other friction of the plant causes a lag behind the reference.
    Source: Siciliano, Sciavicco, Villani and Oriolo, Robotics, 2009, section 8.5.2.

    Attributes:
        motion: the reference.
        limits: largest torques (n,) [N m].
    """

    motion: Reference
    limits: Array

    def torque(self, info: Mapping[str, Any]) -> Array:
        """Compute the torques (n,) for the next period from time, position and velocity in `info` [N m]."""
        body, w = self.motion.body, BANDWIDTH
        time, q, v = info["time"], info["position"], info["velocity"]
        (q_r,), (v_r,), (a_r,) = self.motion(np.array([time]))
        a = a_r + 2 * w * (v_r - v) + w**2 * (q_r - q)
        (torque,) = body.torque(q[None], v[None], a[None]) @ body.values
        viscous, coulomb = self._friction
        return np.clip(torque + viscous * v_r + coulomb * np.sign(v_r), -self.limits, self.limits)

    @cached_property
    def _friction(self) -> Array:
        """Return viscous and dry friction of the joints in the file, by default zero (2, n)."""
        return np.array(get_friction(self.motion.body, np.zeros(len(self.limits)))).T


def follow(
    arm: SimulatedArm,
    motion: Reference,
    samples: int,
    max_torque: float | None = None,
    *,
    rng: np.random.Generator,
    name: str = "simulated",
    progress: Progress = no_progress,
) -> ArmRecording:
    """Record `samples` of a simulated arm that follows a motion.

    Torque stays within `max_torque` [N m] and the limits of the file. `rng` gives the seed of the arm.
    """
    limits = np.minimum(motion.body.torque_limits, np.inf if max_torque is None else max_torque)
    (position,), (velocity,), _ = motion(np.zeros(1))
    seconds = samples / arm.rate
    start = {"position": position, "velocity": velocity}
    run = islice(iterate_steps(arm, Follow(motion, limits), int(rng.integers(2**31)), start), samples)
    measured = collect_samples(run, lambda info: progress(f"{info['time']:.0f} s", info["time"] / seconds))
    return ArmRecording.from_arrays(name, arm.joints, *measured)
