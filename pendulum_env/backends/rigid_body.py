"""The pymunk backend: a rigid body on a pivot, whose dry friction is pymunk's own constraint.

A `SimpleMotor` at rate zero whose force is bounded by fc is set-valued Coulomb friction: it stops the body exactly if
it can, and otherwise brakes it with fc. All other torques are the model's terms, taken at the midpoint of the step. Two
things lift pymunk's first order to the second: the angle moves by the trapezoid of the velocity, and where the body
reverses inside a step, the torque makes up for the friction that the motor only knows in the new direction.
"""

import math
from typing import Any

import pymunk

from pendulum_env.backends.half_steps import HalfSteps
from pendulum_env.backends.simulator import Engine, SteppedBody
from pendulum_env.physics import Samples
from pendulum_env.physics.simulation import UNBOUNDED, TorqueBalance


def make_body(balance: TorqueBalance, longest: float) -> Engine:
    """Make a pendulum in pymunk, or one that NumPy steps if a law is no formula; steps are at most `longest` [s]."""
    try:
        return RigidBody(balance, longest)
    except Exception:  # a user's law may do anything that NumPy does
        return SteppedBody(balance)


class RigidBody:
    """Pendulum in pymunk, as the engine of a simulator."""

    at_rest = 1e-12  # [rad/s], what rounding leaves of a velocity that the motor has stopped

    def __init__(self, balance: TorqueBalance, longest: float) -> None:
        """Take the torques that act on it, and the longest step [s]; raises any exception if a law is no formula."""
        self._balance, self._halves, self._longest = balance, HalfSteps(balance, longest), longest

    def take(self, balance: TorqueBalance) -> None:
        """Go on from where it is with other torques, of terms with the same state variables."""
        memory = self._halves.memory
        self._balance, self._halves = balance, HalfSteps(balance, self._longest)
        self._halves.memory = memory

    def place(self, x: Samples) -> None:
        """Put a new body there: nothing of an earlier run remains, so that equal runs are equal bit for bit."""
        self._time, self._position, self._velocity = float(x.time), float(x.position), float(x.velocity)
        self._inertia, self._dry = float(self._balance.mass(x)), 0.0
        self._halves.place(x)
        self._build()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_space", "_body", "_motor")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if "_time" in state:
            self._build()

    def _build(self) -> None:
        """Build a body balanced about its pivot: the model's terms make gravity and all other torques."""
        self._space = pymunk.Space()
        self._space.iterations = 1  # one motor, and a pivot that carries nothing
        self._body = pymunk.Body(1.0, self._inertia)
        self._body.angle, self._body.angular_velocity = self._position, self._velocity
        self._motor = pymunk.SimpleMotor(self._space.static_body, self._body, 0.0)
        self._motor.max_force = self._dry
        pivot = pymunk.PivotJoint(self._space.static_body, self._body, (0.0, 0.0))
        self._space.add(self._body, pivot, self._motor)

    def step(self, torque: float, h: float) -> tuple[float, float]:
        """Advance by h [s] under a torque [N m]; returns angle [rad] and velocity [rad/s]."""
        q, v, body = self._position, self._velocity, self._body
        body.torque, dry, inertia, moving, middle_v = self._halves.push(self._time, q, v, torque, h)
        if inertia != self._inertia:
            body.moment = self._inertia = inertia
        if dry != self._dry:
            self._motor.max_force = self._dry = dry
        self._space.step(h)
        reached = float(body.angular_velocity)
        if not self.at_rest < abs(reached) < UNBOUNDED:
            reached = 0.0 if abs(reached) <= self.at_rest else math.copysign(UNBOUNDED, reached)
            body.angular_velocity = reached
        body.angle = self._position = q + 0.5 * (v * moving + reached * (h if moving == h else h - moving))
        if self._balance.has_states:
            mean = 0.5 * (middle_v + reached)
            self._halves.complete(self._time + 0.5 * h, q + 0.5 * h * v, mean, torque, h)
        self._time, self._velocity = self._time + h, reached
        return self._position, reached
