"""Mechanisms: the joint of a pendulum, or several joints with links."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.units import TURNING, JointUnits


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Revolute or linear joints: an unnamed joint for a pendulum, and with links a `LinkedMechanism`.

    Attributes:
        joints: names of the n independent joints, from the base on.
        prismatic_joints: names of linear joints, including held ones.
    """

    joints: tuple[str, ...]
    prismatic_joints: frozenset[str]

    can_simulate: ClassVar[bool] = True  # whether models are compared by simulated motion
    can_limit: ClassVar[bool] = True  # whether parameters can be fixed or bounded

    @property
    def is_prismatic(self) -> tuple[bool, ...]:
        """Return whether each joint is linear (n,)."""
        return tuple(joint in self.prismatic_joints for joint in self.joints)

    @property
    def combinations(self) -> dict[str, str]:
        """Return the combinations of parameters as text, by name; empty for a pendulum."""
        return {}

    def units(self, joint: str, recorded: JointUnits = TURNING) -> JointUnits:
        """Return the units of quantities at a joint, given those of a recording."""
        return JointUnits(recorded.torque_unit, recorded.is_prismatic or joint in self.prismatic_joints)


@dataclass(frozen=True)
class BaseParameter:
    """Identifiable combination of standard parameters of links."""

    name: str  # name of the first part, `Izz@shoulder`
    unit: str
    parts: tuple[tuple[str, float], ...]  # standard parameters and factors; the first factor is 1

    @property
    def text(self) -> str:
        """Return the combination as text: `Izz@shoulder + 0.2025 m@elbow`."""
        words = self.name
        for name, factor in self.parts[1:]:
            size = "" if np.isclose(abs(factor), 1.0) else f"{abs(factor):.4g} "
            words += f" {'-' if factor < 0 else '+'} {size}{name}"
        return words


@dataclass(frozen=True, eq=False)
class LinkedMechanism(Mechanism, ABC):
    """Joints with rigid links, whose balance is linear in P base parameters.

    Regressors take N samples of q, v and a, each (N, n) in rad, rad/s, rad/s^2 (m for linear joints). They have one
    column per base parameter (P).

    Attributes:
        name: name of the robot.
        held: positions of fixed joints [rad] or [m], by name.
    """

    name: str
    held: Mapping[str, float]

    can_simulate: ClassVar[bool] = False
    can_limit: ClassVar[bool] = False

    @property
    @abstractmethod
    def base(self) -> tuple[BaseParameter, ...]:
        """Return the base parameters with their combinations."""

    @property
    def impossible_text(self) -> str:
        """Return a sentence that names the links with an impossible inertia; empty without any."""
        return ""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the base parameters."""
        return tuple(parameter.name for parameter in self.base)

    @property
    def combinations(self) -> dict[str, str]:
        """Return the base parameters that combine several standard parameters."""
        return {parameter.name: parameter.text for parameter in self.base if len(parameter.parts) > 1}

    @abstractmethod
    def torque(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torque regressor Y(q, v, a) (N, n, P)."""

    @abstractmethod
    def momentum(self, q: Array, v: Array) -> Array:
        """Return the regressor of M(q) v (N, n, P)."""

    @abstractmethod
    def exchange(self, q: Array, v: Array) -> Array:
        """Return the regressor of dU/dq - dK/dq, the loss of momentum without friction (N, n, P)."""

    @abstractmethod
    def energy(self, q: Array, v: Array) -> Array:
        """Return the regressor of the energy K + U, up to a constant (N, P)."""

    @abstractmethod
    def link_columns(self, joint: str) -> Array:
        """Return the matrix (P, 10) from the standard parameters of a joint's link to the base parameters."""


@dataclass(frozen=True, eq=False)
class LinkLoad:
    """Known body that is fixed to a link.

    Attributes:
        joint: joint that moves the link.
        standard: mass, first moments and inertias (10,) of the body in the joint's frame.
    """

    joint: str
    standard: Array


def describe_joints(names: Sequence[str]) -> str:
    """Describe a mechanism by its joints: `a pendulum`, `an arm with joints hip, knee`."""
    return f"an arm with joints {', '.join(names)}" if any(names) else "a pendulum"


PENDULUM = Mechanism(joints=("",), prismatic_joints=frozenset())
