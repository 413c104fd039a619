"""Joints of a mechanism: the one of a pendulum, or those of an arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from pendulum_env.units import TURNING, JointUnits


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Joints that turn or slide: one without a name for a pendulum; `pendulum_env.arms.Body` also has links.

    Attributes:
        joints: names of the n joints that move by themselves, from the base on.
        sliding: joints that slide instead of turning, also of those that do not move.
    """

    joints: tuple[str, ...]
    sliding: frozenset[str]

    can_simulate: ClassVar[bool] = True  # whether models of it are compared with the motion, by simulating it
    can_limit: ClassVar[bool] = True  # whether parameters of its models may be known or bounded

    @property
    def slides(self) -> tuple[bool, ...]:
        """Return for each joint whether it slides instead of turning (n,)."""
        return tuple(joint in self.sliding for joint in self.joints)

    @property
    def combined(self) -> dict[str, str]:
        """Return the parameters that each parameter combines, by its name; empty for a pendulum."""
        return {}

    def units(self, joint: str, recorded: JointUnits = TURNING) -> JointUnits:
        """Return the units of quantities at a joint, by those of a recording."""
        return JointUnits(recorded.torque_unit, recorded.slides or joint in self.sliding)


def describe_joints(names: Sequence[str]) -> str:
    """Name the kind of mechanism that has these joints: `a pendulum`, `an arm with joints hip, knee`."""
    return f"an arm with joints {', '.join(names)}" if any(names) else "a pendulum"


PENDULUM = Mechanism(joints=("",), sliding=frozenset())
