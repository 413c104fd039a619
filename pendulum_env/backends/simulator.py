"""Backend of a simulated pendulum: a physics engine under a model's torques, with a sensor."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.backends.port import Backend, Sample, Setup, Start, Traits
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.simulation import CommandDelay, TorqueBalance, make_start_samples, step


class Engine(Protocol):
    """Interface of physics engines."""

    def place(self, x: Samples, /) -> None:
        """Begin a new run in the state x (scalars)."""

    def set_balance(self, balance: TorqueBalance, /) -> None:
        """Replace the torque balance, with the same state variables, and keep the state."""

    def step(self, torque: float, h: float, /) -> tuple[float, float]:
        """Advance by h [s] under a torque [N m]; return angle [rad] and velocity [rad/s]."""


class SteppedBody:
    """Engine of a pendulum by the NumPy integrator of `physics.simulation`."""

    def __init__(self, balance: TorqueBalance) -> None:
        """Set the torque balance."""
        self.set_balance(balance)

    def set_balance(self, balance: TorqueBalance) -> None:
        self._balance = balance

    def place(self, x: Samples) -> None:
        self._x = x

    def step(self, torque: float, h: float) -> tuple[float, float]:
        command: Any = np.float64(torque)
        self._x = step(self._balance, replace(self._x, torque=command), h)
        return float(self._x.position), float(self._x.velocity)


class Simulator(Backend):
    """Backend around a physics engine."""

    def __init__(self, setup: Setup, make_engine: Callable[[TorqueBalance, float], Engine]) -> None:
        """Set plant, sampling and sensor; `make_engine` takes a torque balance and the longest step [s]."""
        self.sensor, self.period, self.substeps = setup.sensor, 1.0 / setup.rate, setup.substeps
        self.traits = Traits(setup.rate, setup.sensor.counts, simulated=True)
        self._balance = TorqueBalance(setup.model.terms, setup.model.theta)
        self._engine = make_engine(self._balance, self.period / self.substeps)
        self._command = CommandDelay(setup.model.terms, self.period, self.substeps)

    def set_parameters(self, terms: Sequence[Term], theta: Array) -> None:
        """Replace the parameters, with the same terms and linear parameters theta (P,), and keep the state."""
        self._balance = TorqueBalance(terms, theta)
        self._engine.set_balance(self._balance)
        self._command.set_delay(terms)

    def enable(self, start: Start) -> Sample:
        self._rng = start.rng
        self._command = CommandDelay(self._balance.terms, self.period, self.substeps)
        self._engine.place(make_start_samples(self._balance, start.position, start.velocity))
        self._state = start.position, start.velocity
        self._count = 0  # periods since the start
        return self._sample(0.0)._replace(torque=0.0)

    def exchange(self, torque: float) -> Sample:
        duration = self.period / self.substeps
        for command in self._command.delay_command(torque):
            self._state = self._engine.step(float(command), duration)
        self._count += 1
        return self._sample(torque)

    def _sample(self, torque: float) -> Sample:
        position, velocity = self._state
        return Sample(
            self._count * self.period,
            float(self.sensor.position(position)),
            None if not self.sensor.ideal_velocity else velocity,
            float(self.sensor.torque(torque, self._rng)),
        )
