"""Simulated robots that follow a chosen motion, by an installed package."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.plugins import load_plugins, make_missing_error
from pendulum_env.policy import Policy
from pendulum_env.recording import Recording

SIMULATORS = "pendulum_ident.simulators"  # entry points of functions with the arguments of `simulate_robot`


class PlannedRun(ABC):
    """Motion of a simulated robot before its simulation; `str` describes it."""

    @property
    @abstractmethod
    def condition(self) -> float:
        """Return the condition number of the regressor of the motion."""

    @abstractmethod
    def compute_positions(self, time: Array) -> Array:
        """Compute the planned positions of the joints (N, n) [rad] or [m] at N instants [s]."""

    @abstractmethod
    def record(
        self,
        samples: int,
        max_torque: float | None,
        rng: np.random.Generator,
        name: str,
        progress: Callable[[str, float], None],
    ) -> Recording:
        """Simulate the robot that follows the motion, with torques up to `max_torque` [N m].

        `progress` receives the text of the current work, and the share that is done.
        """


class SimulatedRobot(ABC):
    """Simulated robot that follows planned motions."""

    @abstractmethod
    def plan_run(
        self,
        seconds: float,
        rng: np.random.Generator,
        policy: Policy | None = None,
        *,
        max_angle: float | None = None,
        max_speed: float | None = None,
        max_torque: float | None = None,
    ) -> PlannedRun:
        """Choose a motion within limits [rad, rad/s, N m] by a policy, or by a design without one."""


def simulate_robot(
    body: LinkedMechanism, rate: float, counts: int, effects: Sequence[str], backend: str | None = None
) -> SimulatedRobot:
    """Simulate a robot by an installed package, the first by the name of its entry point.

    Args:
        body: links of the robot.
        rate: samples per second [Hz].
        counts: encoder counts per turn.
        effects: texts of hidden effects at joints.
        backend: name of the simulator; None: one that suits the robot.
    """
    simulators = [*load_plugins(SIMULATORS).values()]
    if not simulators:
        raise make_missing_error(SIMULATORS, "simulates arms")
    simulated: SimulatedRobot = simulators[0](body, rate, counts, effects, backend)
    return simulated
