"""Effects at joints: any effect of a pendulum's library at joint i, as a function of q_i, q'_i and tau_i.

Friction of an arm is decentralised, f_i(q'_i, tau_i) (the paper's (1)), and so is whatever else a joint does. A term
at a joint is the pendulum's term under another name, `stribeck@elbow`; it meets the samples of its own joint only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, cast

from pendulum_env.lookup import find
from pendulum_env.mistake import Mistake
from pendulum_env.physics import Column, Term, effects
from pendulum_env.physics.base import Coulomb, Viscous

if TYPE_CHECKING:
    from pendulum_env.arms.body import Body

FRICTION: tuple[Term, ...] = (Viscous(), Coulomb())  # of a joint, where nothing else is known
# What depends on more than the own joint's motion: a link behind the motor, the arm's weight, a load's inertia
OF_THE_ARM = ("load_dependent_friction.output",)  # columns that an effect has where its joint alone makes them
NOT_DECENTRALISED = ("backlash", "joint_flexibility", "encoder_eccentricity", "gravity_tilt", "payload_change")


_known: dict[tuple[type[Term], str], type[Term]] = {}  # so that the same effect at the same joint is the same class


def at_joint(effect: type[Term], joint: str) -> type[Term]:
    """An effect as it is at one of several joints: the same law, with `@joint` behind its id and its parameters.

    Raises:
        ValueError: if it is at a joint already.
    """
    if effect.at:
        raise Mistake(f"{effect.id} is at a joint already: place {effect.id.partition('@')[0]} at '{joint}' instead")
    if (effect, joint) not in _known:
        _known[effect, joint] = _at_joint(effect, joint)
    return _known[effect, joint]


def _at_joint(effect: type[Term], joint: str) -> type[Term]:
    def named(columns: Sequence[Column]) -> tuple[Column, ...]:
        own = (column for column in columns if column.name not in OF_THE_ARM)
        return tuple(replace(column, name=f"{column.name}@{joint}") for column in own)

    content: dict[str, Any] = {
        "__module__": effect.__module__,
        "__doc__": effect.__doc__,
        "__reduce__": lambda term: (placed, (effect(**term.shape), joint)),
        "id": f"{effect.id}@{joint}",
        "at": joint,
        "shapes": tuple(shape for shape in effect.shapes if not shape.follows),
        "columns": property(lambda term: named(cast(Any, effect).columns.fget(term))),
        "fixed": property(lambda term: named(cast(Any, effect).fixed.fget(term))),
    }
    return cast(type[Term], type(f"{effect.__name__}@{joint}", (effect,), content))


def placed(term: Term, joint: str) -> Term:
    """A term as it is at a joint."""
    return at_joint(type(term), joint)(**term.shape)


def check_places(terms: Sequence[Term], joints: Sequence[str]) -> None:
    """Refuse terms that are at no joint of an arm.

    Raises:
        ValueError: with the term, and the joints that there are.
    """
    for term in terms:
        if term.at not in joints:
            raise Mistake(
                f"{term.id} is at none of the joints {', '.join(joints)}: place it, placed(term, {joints[0]!r})"
            )


def friction(joints: Sequence[str]) -> tuple[Term, ...]:
    """Viscous and Coulomb friction at each joint."""
    return tuple(placed(term, joint) for joint in joints for term in FRICTION)


def joint_effects() -> dict[str, type[Term]]:
    """Effects of the library that can sit at a joint of an arm, by id."""
    return {id: effect for id, effect in effects().items() if id not in NOT_DECENTRALISED}


def effect_at(text: str, joints: Sequence[str]) -> tuple[type[Term], str]:
    """Effect and joint of `stribeck@elbow`.

    Raises:
        ValueError: if there is no such effect or joint; the message names the nearest.
    """
    id, at, joint = text.partition("@")
    if not at and id not in NOT_DECENTRALISED:
        raise Mistake(f"'{text}' should say at which joint: {text}@{joints[0]}, for one")
    if id in NOT_DECENTRALISED:
        raise Mistake(f"{id} is no effect of one joint's motion and torque alone: it cannot sit at a joint of an arm")
    return find("effect", id, joint_effects()), find("joint", joint, {name: name for name in joints})


@dataclass(frozen=True, eq=False)
class Links(Term):
    """The rigid body of an arm: one column for each base parameter, which the motion of all joints makes."""

    body: Body

    id = "links"
    law = "M(q) q'' + C(q, q') q' + g(q)"
    kind = "inertial"

    @property
    def columns(self) -> tuple[Column, ...]:
        """Base parameters; `Body` has their regressors."""
        return tuple(Column(parameter.name, parameter.unit) for parameter in self.body.base)

    @property
    def shape(self) -> dict[str, float]:
        """It has none."""
        return {}
