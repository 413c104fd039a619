"""A run of an arm under a controller, kept as a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.arms.env import PlanarArm
from pendulum_env.arms.recording import ArmRecording


class ArmController(Protocol):
    """What chooses the torques of an arm from its measurement."""

    def torque(self, info: Mapping[str, Any]) -> Array:
        """Torques (n,) for the period that begins now [N m]; `info` is the environment's."""


def rollout_arm(
    env: PlanarArm,
    controller: ArmController,
    steps: int,
    *,
    position: Array,
    velocity: Array,
    seed: int | None = None,
    name: str = "rollout",
    watch: Callable[[Mapping[str, Any]], None] | None = None,
) -> ArmRecording:
    """Run a controller and keep the measurement: one sample for each step; its torque acts from its time on.

    Args:
        env: the arm.
        controller: of its torques.
        steps: samples.
        position: of the joints at the beginning (n,) [rad].
        velocity: of the joints at the beginning (n,) [rad/s].
        seed: of the noise.
        name: of the recording.
        watch: called with each step's `info`.

    Raises:
        RecordingError: if the motion is none that a recording can hold, as that of an arm which nothing holds back.
    """
    _, info = env.reset(seed=seed, options={"position": position, "velocity": velocity})
    time = np.empty(steps)
    positions, torques = np.empty((2, steps, len(env.joints)))
    for k in range(steps):
        time[k], positions[k] = info["time"], info["position"]
        info = env.step(controller.torque(info))[4]
        torques[k] = info["torque"]
        if watch is not None:
            watch(info)
    return ArmRecording.of(name, env.joints, time, positions, torques)
