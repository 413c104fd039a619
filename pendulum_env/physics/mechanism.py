"""Joints of a mechanism: a pendulum or an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from pendulum_env.units import TURNING, JointUnits


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Revolute or linear joints: an unnamed joint for a pendulum, and with links `pendulum_env.arms.Body`.

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
    def combined(self) -> dict[str, str]:
        """Return the combinations of parameters as text, by name; empty for a pendulum."""
        return {}

    def units(self, joint: str, recorded: JointUnits = TURNING) -> JointUnits:
        """Return the units of quantities at a joint, given those of a recording."""
        return JointUnits(recorded.torque_unit, recorded.is_prismatic or joint in self.prismatic_joints)


def describe_joints(names: Sequence[str]) -> str:
    """Describe a mechanism by its joints: `a pendulum`, `an arm with joints hip, knee`."""
    return f"an arm with joints {', '.join(names)}" if any(names) else "a pendulum"


PENDULUM = Mechanism(joints=("",), prismatic_joints=frozenset())
