"""The pymunk backend: a rigid body on a pivot, whose dry friction is pymunk's own constraint.

A `SimpleMotor` at rate zero whose force is bounded by fc is set-valued Coulomb friction: it stops the body exactly if
it can, and otherwise brakes it with fc. All other torques are the model's terms, taken at the midpoint of the step. Two
things lift pymunk's first order to the second: the angle moves by the trapezoid of the velocity, and where the body
reverses inside a step, the torque makes up for the friction that the motor only knows in the new direction.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymunk

from pendulum_env.physics import Samples
from pendulum_env.physics.simulation import UNBOUNDED, Balance

Scalar = Any  # np.float64, where terms broadcast over arrays
AT_REST = 1e-12  # [rad/s], what rounding leaves of a velocity that the motor has stopped


class RigidBody:
    """A pendulum in pymunk, as the engine of a simulator."""

    def __init__(self, balance: Balance) -> None:
        """Take the torques that act on it."""
        self._balance = balance

    def place(self, x: Samples) -> None:
        """Put a new body there: nothing of an earlier run remains, so that equal runs are equal bit for bit."""
        self._x = x
        self._inertia, self._dry = float(self._balance.mass(x)), 0.0
        self._build()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_space", "_body", "_motor")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if "_x" in state:
            self._build()

    def _build(self) -> None:
        """A body that is balanced about its pivot: gravity comes from the model's term, as every other torque."""
        self._space = pymunk.Space()
        self._space.iterations = 1  # one motor, and a pivot that carries nothing
        self._body = pymunk.Body(1.0, self._inertia)
        self._body.angle, self._body.angular_velocity = float(self._x.position), float(self._x.velocity)
        self._motor = pymunk.SimpleMotor(self._space.static_body, self._body, 0.0)
        self._motor.max_force = self._dry
        pivot = pymunk.PivotJoint(self._space.static_body, self._body, (0.0, 0.0))
        self._space.add(self._body, pivot, self._motor)

    def step(self, x: Samples, h: float) -> Samples:
        """Advance by h [s]."""
        balance: Any = self._balance
        command = x.torque
        q: Scalar = x.position
        v: Scalar = x.velocity
        # velocity at the midpoint, friction keeping its direction; a body that starts to move takes that of the net
        net, dry = balance.net(x), max(balance.dry(x), 0.0)
        direction = math.copysign(1.0, v) if v else math.copysign(float(abs(net) > dry), net)
        middle_v = v + 0.5 * h * (net - dry * direction) / balance.mass(x) if direction else v
        if middle_v * direction <= 0:
            middle_v = np.float64(0.0)
        memory = self._balance.advance(x, 0.5 * (v + middle_v), 0.5 * h)
        middle = Samples(x.time + 0.5 * h, q + 0.5 * h * v, middle_v, command, memory)
        net, dry, inertia = float(balance.net(middle)), max(float(balance.dry(middle)), 0.0), balance.mass(middle)

        moving = h  # how long the body keeps its direction
        acceleration = (net - dry * direction) / inertia
        if direction and (v + h * acceleration) * direction < 0:
            moving = -v / acceleration
            if abs(net) > dry:
                net -= 2.0 * dry * direction * moving / h
        reached = self._push(net, dry, float(inertia), h)
        position = q + 0.5 * (v * moving + reached * (h if moving == h else h - moving))
        self._body.angle = float(position)
        memory = self._balance.advance(middle, 0.5 * (middle_v + reached), 0.5 * h)
        self._x = Samples(x.time + h, position, reached, command, memory)
        return self._x

    def _push(self, torque: float, dry: float, inertia: float, h: float) -> Scalar:
        """Velocity of the body [rad/s] after h [s] under a torque against the motor's friction."""
        body = self._body
        if inertia != self._inertia:
            body.moment = self._inertia = inertia
        if dry != self._dry:
            self._motor.max_force = self._dry = dry
        body.torque = torque
        self._space.step(h)
        reached = body.angular_velocity
        if not AT_REST < abs(reached) < UNBOUNDED:
            reached = 0.0 if abs(reached) <= AT_REST else math.copysign(UNBOUNDED, reached)
            body.angular_velocity = reached
        return np.float64(reached)
