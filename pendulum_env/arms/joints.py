"""Effects at joints: any effect of a pendulum's library at joint i, as a function of q_i, q'_i and tau_i.

Friction of an arm is decentralised, f_i(q'_i, tau_i) (the paper's (1)), and so is whatever else a joint does. A term
at a joint is the pendulum's term under another name, `stribeck@elbow`; it meets the samples of its own joint only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.physics import Term, effects
from pendulum_env.physics.base import Coulomb, Viscous

FRICTION: tuple[Term, ...] = (Viscous(), Coulomb())  # of a joint, where nothing else is known
# What depends on more than the own joint's motion: a link behind the motor, the arm's weight, a load's inertia
NOT_DECENTRALISED = ("backlash", "joint_flexibility", "encoder_eccentricity", "gravity_tilt", "payload_change")


@dataclass(frozen=True)
class JointTerm:
    """A term at one of n joints.

    Attributes:
        joint: its index, from the base on.
        at: its name.
        term: the pendulum's term.
    """

    joint: int
    at: str
    term: Term

    @property
    def id(self) -> str:
        """`stribeck@elbow`."""
        return f"{self.term.id}@{self.at}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the linear parameters, `cogging.sin@elbow`."""
        return tuple(f"{column.name}@{self.at}" for column in self.term.columns)

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Names of the shape parameters, `stribeck.stribeck_velocity@elbow`."""
        return tuple(f"{self.term.id}.{shape.name}@{self.at}" for shape in self.term.free)


def friction(joints: Sequence[str]) -> tuple[JointTerm, ...]:
    """Viscous and Coulomb friction at each joint."""
    return tuple(JointTerm(k, joint, term) for k, joint in enumerate(joints) for term in FRICTION)


def joint_effects() -> dict[str, type[Term]]:
    """Effects of the library that can sit at a joint of an arm, by id."""
    return {id: effect for id, effect in effects().items() if id not in NOT_DECENTRALISED}


def effect_at(text: str, joints: Sequence[str]) -> tuple[type[Term], int]:
    """Effect and index of the joint of `stribeck@elbow`.

    Raises:
        ValueError: if there is no such effect or joint; the message names the nearest.
    """
    id, at, joint = text.partition("@")
    if not at:
        raise Mistake(f"'{text}' should say at which joint: {text}@{joints[0]}, for one")
    if id in NOT_DECENTRALISED:
        raise Mistake(f"{id} is no effect of one joint's motion and torque alone: it cannot sit at a joint of an arm")
    return find("effect", id, joint_effects()), joints.index(find("joint", joint, {name: name for name in joints}))
