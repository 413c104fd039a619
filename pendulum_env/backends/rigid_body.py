"""Pymunk backend: a rigid pendulum on a pivot, with dry friction as a pymunk constraint.

A `SimpleMotor` of rate zero, with its force bounded by fc, is set-valued Coulomb friction: it stops the motion exactly
if it can, and otherwise brakes with fc. All other torques are the model's terms, evaluated at the midpoint of the step.
Two corrections make pymunk's scheme second order. The angle follows the trapezoidal rule. If the motion reverses in a
step, the torque is corrected for the friction before the reversal, because the motor acts only in the new direction.
State variables advance by half a midpoint step before pymunk's step and by half a step after it; both halves are
compiled.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pymunk

from pendulum_env.backends.simulator import Engine, SteppedBody
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.compiled import Machine, SymbolicStep
from pendulum_env.physics.simulation import UNBOUNDED, TorqueBalance, move_half_way, write_balance
from pendulum_env.physics.symbols import make_symbol
from pendulum_env.physics.term import round_up

# setters of pymunk's properties; an assignment takes twice the time, since `pymunk.Body` overrides `__setattr__`
set_torque, set_angle = (getattr(pymunk.Body, name).fset for name in ("torque", "angle"))


def make_body(balance: TorqueBalance, longest_step: float) -> Engine:
    """Make a pymunk engine for steps up to `longest_step` [s], or a NumPy engine if a law is not symbolic."""
    try:
        return RigidBody(balance, longest_step)
    except Exception:  # a user's law may raise any error with symbols
        return SteppedBody(balance)


class RigidBody:
    """Engine of a pendulum in pymunk."""

    at_rest = 1e-12  # [rad/s], rounding error of the velocity of a stopped pendulum

    def __init__(self, balance: TorqueBalance, longest_step: float) -> None:
        """Set the torque balance and the longest step [s]; raise an exception if a law is not symbolic."""
        arguments = balance.terms, round_up(longest_step)
        self._first, self._second = (Machine(_write_half, (*arguments, is_first), 1) for is_first in (True, False))
        self._nonlinear = [(k, parameter.name) for k, term in enumerate(balance.terms) for parameter in term.free]
        self.set_balance(balance)

    def set_balance(self, balance: TorqueBalance) -> None:
        self._balance, self._has_states = balance, balance.has_states
        nonlinear = [getattr(balance.terms[place], name) for place, name in self._nonlinear]
        for half in (self._first, self._second):
            half.inputs["constants"][:, 0] = *balance.theta, *nonlinear

    def place(self, x: Samples) -> None:
        # a new space, so that equal runs are bitwise equal
        self._time, self._position, self._velocity = float(x.time), float(x.position), float(x.velocity)
        self._inertia, self._dry = float(self._balance.mass(x)), 0.0
        self._first.inputs["memory"][:, 0] = _flatten_samples(x)
        # its centre of mass is at the pivot; gravity is a term of the model
        self._space = pymunk.Space()
        self._space.iterations = 1  # exact for one motor and an unloaded pivot
        self._pendulum = pymunk.Body(1.0, self._inertia)
        self._pendulum.angle, self._pendulum.angular_velocity = self._position, self._velocity
        self._motor = pymunk.SimpleMotor(self._space.static_body, self._pendulum, 0.0)
        self._motor.max_force = self._dry
        pivot = pymunk.PivotJoint(self._space.static_body, self._pendulum, (0.0, 0.0))
        self._space.add(self._pendulum, pivot, self._motor)

    def step(self, torque: float, h: float) -> tuple[float, float]:
        q, v, pendulum = self._position, self._velocity, self._pendulum
        first, second = self._first, self._second
        first.inputs["state"][:, 0] = self._time, q, v, torque, h
        first.step()
        torque_of_step, dry, inertia, motion_time, middle_velocity = first.states["step_torque"][:, 0].tolist()
        set_torque(pendulum, torque_of_step)
        if inertia != self._inertia:
            pendulum.moment = self._inertia = inertia
        if dry != self._dry:
            self._motor.max_force = self._dry = dry
        self._space.step(h)
        velocity: float = pendulum.angular_velocity
        if not self.at_rest < abs(velocity) < UNBOUNDED:
            velocity = 0.0 if abs(velocity) <= self.at_rest else math.copysign(UNBOUNDED, velocity)
            pendulum.angular_velocity = velocity
        rest_of_step = h if motion_time == h else h - motion_time
        self._position = q + 0.5 * (v * motion_time + velocity * rest_of_step)
        set_angle(pendulum, self._position)
        if self._has_states:
            mean = 0.5 * (middle_velocity + velocity)
            second.inputs["state"][:, 0] = self._time + 0.5 * h, q + 0.5 * h * v, mean, torque, h
            second.inputs["memory"][:] = first.states["memory"]
            second.step()
            first.inputs["memory"][:] = second.states["memory"]
        self._time, self._velocity = self._time + h, velocity
        return self._position, velocity


class StepTorque(NamedTuple):
    """Mean torque, friction and inertia of a step."""

    torque: float  # mean torque without dry friction [N m]
    dry: float  # largest dry friction [N m]
    inertia: float  # [kg m^2]
    motion_time: float  # time until the motion reverses, or the step [s]
    middle_velocity: float  # velocity at the middle of the step [rad/s]


def _compute_step_torque(balance: TorqueBalance, x: Samples, h: Any) -> tuple[StepTorque, Samples]:
    """Return the torque of a step and the samples at the middle of the step, of numbers or symbols.

    If the motion reverses within the step, the torque is corrected for the friction before the reversal.
    """
    v: Any = x.velocity
    direction, middle = move_half_way(balance, x, h)
    net, dry, inertia = balance.net(middle), np.maximum(balance.dry(middle), 0.0), balance.mass(middle)
    acceleration = (net - dry * direction) / inertia
    is_reversed = (v + h * acceleration) * direction < 0
    motion_time = np.where(is_reversed, -v / np.where(is_reversed, acceleration, 1.0), h)
    corrected = net - 2.0 * dry * direction * motion_time / h
    net = np.where(is_reversed & (np.abs(net) > dry), corrected, net)
    return StepTorque(net, dry, inertia, motion_time, middle.velocity), middle  # type: ignore[arg-type]


def _write_half(terms: tuple[Term, ...], longest_step: float, is_first: bool) -> SymbolicStep:
    """Write the first half of a step, with its torque, or the second half, in symbols."""
    balance, x, nonlinear = write_balance(terms)
    h: Any = make_symbol("h", largest=longest_step)
    inputs = {
        "state": _stack_values([x.time, x.position, x.velocity, x.torque, h]),
        "constants": _stack_values([*balance.theta, *nonlinear]),
        "memory": _flatten_samples(x),
    }
    if is_first:
        step_torque, middle = _compute_step_torque(balance, x, h)
        return SymbolicStep(inputs, {}, {"step_torque": _stack_values(step_torque), "memory": _flatten_samples(middle)})
    memory = balance.advance(x, x.velocity, 0.5 * h)
    return SymbolicStep(inputs, {}, {"memory": _flatten_samples(replace(x, memory=memory))})


def _flatten_samples(x: Samples) -> Any:
    return _stack_values([value for memory in x.memory.values() for value in memory])


def _stack_values(values: Any) -> Any:
    return np.array([*values], dtype=object)
