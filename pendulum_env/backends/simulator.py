"""A simulated pendulum as a backend: a model's torques on the body of a physics engine, seen through a sensor."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.backends.port import Backend, Sample, Setup, Start, Traits
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.simulation import CommandLine, TorqueBalance, begin, step


class Engine(Protocol):
    """Interface of physics engines."""

    def place(self, x: Samples, /) -> None:
        """Begin a run there, scalars; nothing of an earlier one remains."""

    def take(self, balance: TorqueBalance, /) -> None:
        """Go on from where it is with other torques, of terms with the same state variables."""

    def step(self, torque: float, h: float, /) -> tuple[float, float]:
        """Advance by h [s] under a torque [N m], from where the last step ended: angle [rad], velocity [rad/s]."""


class SteppedBody:
    """Pendulum that the model's own step moves by NumPy, as the engine of a simulator."""

    def __init__(self, balance: TorqueBalance) -> None:
        """Take the torques that act on it."""
        self.take(balance)

    def take(self, balance: TorqueBalance) -> None:
        """Go on from where it is with other torques."""
        self._balance = balance

    def place(self, x: Samples) -> None:
        """Begin there."""
        self._x = x

    def step(self, torque: float, h: float) -> tuple[float, float]:
        """Advance by h [s] under a torque [N m]; returns angle [rad] and velocity [rad/s]."""
        command: Any = np.float64(torque)
        self._x = step(self._balance, replace(self._x, torque=command), h)
        return float(self._x.position), float(self._x.velocity)


class Simulator(Backend):
    """Engine as a backend."""

    def __init__(self, setup: Setup, make: Callable[[TorqueBalance, float], Engine]) -> None:
        """Take the plant, sampling and sensor of the setup, and what makes the engine for steps so long at most."""
        self.sensor, self.period, self.substeps = setup.sensor, setup.period, setup.substeps
        self.traits = Traits(setup.rate, setup.sensor.counts, simulated=True)
        self._balance = TorqueBalance(setup.model.terms, setup.model.theta)
        self._engine = make(self._balance, self.period / self.substeps)
        self._command = CommandLine(setup.model.terms, self.period, self.substeps)

    def take(self, terms: Sequence[Term], theta: Array) -> None:
        """Go on from where it is with other parameters: the same terms, and linear parameters theta (P,)."""
        self._balance = TorqueBalance(terms, theta)
        self._engine.take(self._balance)
        self._command.take(terms)

    def enable(self, start: Start) -> Sample:
        """Put the body at the start."""
        self._rng = start.rng
        self._command = CommandLine(self._balance.terms, self.period, self.substeps)
        self._engine.place(begin(self._balance, start.position, start.velocity))
        self._at = start.position, start.velocity
        self._count = 0  # of periods since
        return self._sample(0.0)._replace(torque=0.0)

    def exchange(self, torque: float) -> Sample:
        """Advance by one period under the torque [N m]."""
        duration = self.period / self.substeps
        for command in self._command.push(torque):
            self._at = self._engine.step(float(command), duration)
        self._count += 1
        return self._sample(torque)

    def _sample(self, torque: float) -> Sample:
        position, velocity = self._at
        return Sample(
            self._count * self.period,
            float(self.sensor.position(position)),
            None if not self.sensor.ideal_velocity else velocity,
            float(self.sensor.torque(torque, self._rng)),
        )
