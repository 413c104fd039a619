"""Impulses of the terms of a model for a physics engine: a splitting of second order around the step of the engine.

Up to the push, a step is half one of the midpoint rule; after it, state variables go the other half. Both are compiled.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pendulum_env.physics import Samples, Term
from pendulum_env.physics.compiled import Machine, SymbolicStep
from pendulum_env.physics.simulation import TorqueBalance, move_half_way, write_balance
from pendulum_env.physics.symbols import make_symbol
from pendulum_env.physics.term import round_up


class Push(NamedTuple):
    """Impulses and friction of a step of the engine."""

    torque: float  # besides dry friction [N m]
    dry: float  # largest dry friction [N m]
    inertia: float  # [kg m^2]
    moving: float  # duration of motion in one direction [s]
    middle: float  # velocity at the middle of the step [rad/s]


class HalfSteps:
    """Two halves of a step, with the states of the terms; raises any exception if a law is no formula."""

    def __init__(self, balance: TorqueBalance, longest: float) -> None:
        self._until, self._after = (
            Machine(half, (balance.terms, round_up(longest)), 1) for half in (_compile_first, _compile_second)
        )
        _, _, nonlinear = write_balance(balance.terms)
        for machine in (self._until, self._after):
            machine.given["constants"][:, 0] = *balance.theta, *nonlinear.values()

    @property
    def memory(self) -> Any:
        """Return the states of the terms."""
        return self._until.given["memory"].copy()

    @memory.setter
    def memory(self, values: Any) -> None:
        self._until.given["memory"][:] = values

    def place(self, x: Samples) -> None:
        """Begin there."""
        self._until.given["memory"][:, 0] = _flatten_samples(x)

    def push(self, *state: float) -> Push:
        """Compute the impulse of a step and advance the states to its middle.

        `state` is time, position, velocity, torque and the length of the step.
        """
        self._until.given["state"][:, 0] = state
        self._until.step()
        return Push._make(self._until.now["push"][:, 0].tolist())

    def complete(self, *state: float) -> None:
        """Advance the states from the middle of a step to its end, at the mean velocity; `state` as in `push`."""
        self._after.given["state"][:, 0], self._after.given["memory"][:] = state, self._until.now["memory"]
        self._after.step()
        self._until.given["memory"][:] = self._after.now["memory"]


def _compute_push(balance: TorqueBalance, x: Samples, h: Any) -> tuple[Push, Samples]:
    """Compute the impulse and the middle of the step, of numbers or symbols.

    Where the body reverses inside the step, the torque makes up for the friction that an engine only knows in the new
    direction.
    """
    v: Any = x.velocity
    direction, middle = move_half_way(balance, x, h)
    net, dry, inertia = balance.net(middle), np.maximum(balance.dry(middle), 0.0), balance.mass(middle)
    acceleration = (net - dry * direction) / inertia
    reverses = (v + h * acceleration) * direction < 0
    moving = np.where(reverses, -v / np.where(reverses, acceleration, 1.0), h)
    turned = net - 2.0 * dry * direction * moving / h
    net = np.where(reverses & (np.abs(net) > dry), turned, net)
    return Push(net, dry, inertia, moving, middle.velocity), middle  # type: ignore[arg-type]


def _compile_first(terms: tuple[Term, ...], longest: float) -> SymbolicStep:
    balance, x, given = _make_symbols(terms, longest)
    push, middle = _compute_push(balance, x, given["state"][-1])
    return SymbolicStep(given, {}, {"push": _make_array(push), "memory": _flatten_samples(middle)})


def _compile_second(terms: tuple[Term, ...], longest: float) -> SymbolicStep:
    balance, x, given = _make_symbols(terms, longest)
    memory = balance.advance(x, x.velocity, 0.5 * given["state"][-1])
    return SymbolicStep(given, {}, {"memory": _flatten_samples(replace(x, memory=memory))})


def _make_symbols(terms: tuple[Term, ...], longest: float) -> tuple[TorqueBalance, Samples, dict[str, Any]]:
    balance, x, nonlinear = write_balance(terms)
    state = _make_array([x.time, x.position, x.velocity, x.torque, make_symbol("h", most=longest)])
    return (
        balance,
        x,
        {
            "state": state,
            "constants": _make_array([*balance.theta, *map(make_symbol, nonlinear)]),
            "memory": _flatten_samples(x),
        },
    )


def _flatten_samples(x: Samples) -> Any:
    return _make_array([value for own in x.memory.values() for value in own])


def _make_array(values: Any) -> Any:
    return np.array([*values], dtype=object)
