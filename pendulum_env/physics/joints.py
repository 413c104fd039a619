"""Effects at the joints of a mechanism, as functions of q_i, q'_i and tau_i of joint i.

Friction is decentralised, f_i(q'_i, tau_i) (equation (1) of the paper); other effects are treated likewise. A
term at a joint is the term of the pendulum with another id, `stribeck@elbow`, evaluated on the samples of this joint.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import ClassVar, TypeVar, cast

import numpy as np

from pendulum_env.errors import UserError
from pendulum_env.lookup import find
from pendulum_env.physics import Column, Term, list_nameable
from pendulum_env.physics.base import BASE, Coulomb, Viscous
from pendulum_env.physics.library import MEASURED, find_addition
from pendulum_env.physics.mechanism import PENDULUM, LinkedMechanism, Mechanism
from pendulum_env.physics.table import TABLES
from pendulum_env.physics.term import derive_kind, list_loads, return_one
from pendulum_env.units import JointUnits

T = TypeVar("T")
FRICTION: tuple[Term, ...] = (Viscous(), Coulomb())  # base friction of a joint
DRAWS = 60  # samples of random motion
NEGLIGIBLE = 1e-6  # relative norm of a residual torque below which links explain the torque


@dataclass(frozen=True)
class Rotor(Term):
    """Inertia of a motor's rotor at its joint, reflected by the gear. A robot file often lacks it."""

    id = "rotor"
    law = "I q''"
    kind = "inertial"

    @property
    def columns(self) -> tuple[Column, ...]:
        """Return the column of inertia."""
        return (Column("rotor", "kg m^2", mass=return_one, least=0.0),)


def is_possible_at_joint(kind: type[Term], is_prismatic: bool = False) -> bool:
    """Return whether an effect is possible at a revolute or linear joint of a linked mechanism."""
    return kind.is_decentralised and not (is_prismatic and kind.is_revolute_only)


def place_effect(effect: type[Term], joint: str, is_prismatic: bool = False) -> type[Term]:
    """Make the effect at a joint: the same law, with `@joint` appended to its id and parameters.

    For a linear joint, units have m and N. The joint of a pendulum has an empty name and returns the effect itself.
    """
    if not joint:
        return effect
    if effect.at:
        raise UserError(f"{effect.id} is at a joint already: place {effect.id.partition('@')[0]} at '{joint}' instead")
    return _make_placed_effect(cast(Hashable, effect), joint, is_prismatic)


@cache  # one class per effect and joint
def _make_placed_effect(effect: type[Term], joint: str, is_prismatic: bool) -> type[Term]:
    units = JointUnits(is_prismatic=is_prismatic)

    def name_columns(columns: Sequence[Column]) -> tuple[Column, ...]:
        of_joint = (column for column in columns if not column.is_of_weight)
        return tuple(replace(c, name=f"{c.name}@{joint}", unit=units.unit(c.unit)) for c in of_joint)

    placed_effect = derive_kind(
        effect, place_effect, joint, is_prismatic,
        id=f"{effect.id}@{joint}",
        at=joint,
        is_prismatic=is_prismatic,
        nonlinear_parameters=tuple(
            replace(p, unit=p.get_unit(units)) for p in effect.nonlinear_parameters if not p.follows
        ),
        columns=cached_property(lambda term: name_columns(super(placed_effect, term).columns)),
        fixed=cached_property(lambda term: name_columns(super(placed_effect, term).fixed)),
    )  # fmt: skip
    return placed_effect


@dataclass(frozen=True)
class Coupling(Term):
    """Inertia and friction of a motor at q_a + s q_b of two joints, s = 1 or -1, as in geared wrists and with cables.

    Its torque acts on joint a, and s times that torque on joint b. Made by `get_coupling`.
    Source: Gautier, Janot and Vandanjon, IEEE Transactions on Control Systems Technology 21(2), 2013 (Staubli TX40).
    """

    id = "coupling"
    law = "(I w' + b w + c sgn w) (1, s) with w = q_a' + s q_b'"
    kind = "dissipative"
    is_revolute_only = True
    is_heavy: ClassVar[bool] = True  # has an inertia column; False if link parameters explain it (parallel axes)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Return the columns of inertia and friction as functions of the motor's motion."""
        friction = (
            Column(f"coupling.viscous@{self.at}", "N m s/rad", force=lambda x: x.velocity, least=0.0),
            Column(f"coupling.coulomb@{self.at}", "N m", dry=return_one, least=0.0),
        )
        inertia = Column(f"coupling.inertia@{self.at}", "kg m^2", mass=return_one, least=0.0)
        return (inertia, *friction) if self.is_heavy else friction


@cache
def _make_coupling(kind: type[Coupling], at: str, is_heavy: bool) -> type[Coupling]:
    return derive_kind(kind, _make_coupling, at, is_heavy, id=f"coupling@{at}", at=at, is_heavy=is_heavy)


def get_coupling(at: str, is_heavy: bool) -> type[Coupling]:
    """Return the coupling of two joints, `elbow,wrist` or `elbow,-wrist`, with or without motor inertia."""
    return _make_coupling(Coupling, at, is_heavy)


def list_couplings(mechanism: LinkedMechanism) -> tuple[type[Coupling], ...]:
    """List the couplings of adjacent revolute joints, with both signs."""
    can_couple = [is_possible_at_joint(Coupling, is_linear) for is_linear in mechanism.is_prismatic]
    pairs = [pair for pair, flags in zip(pairwise(mechanism.joints), pairwise(can_couple), strict=True) if all(flags)]
    return tuple(choose_coupling(f"{first},{sign}{second}", mechanism) for first, second in pairs for sign in ("", "-"))


def choose_coupling(at: str, mechanism: LinkedMechanism) -> type[Coupling]:
    """Return the coupling of two joints, without motor inertia if link parameters explain it."""
    return get_coupling(at, has_separate_rotor(at, mechanism))


def has_separate_rotor(at: str, mechanism: LinkedMechanism) -> bool:
    """Return whether no link parameters explain the inertia of a motor at one joint, or at two coupled ones."""
    factors = np.array([list_loads(at).get(joint, 0.0) for joint in mechanism.joints])
    q, v, a = np.random.default_rng(0).uniform(-np.pi, np.pi, (3, DRAWS, len(mechanism.joints)))
    motor_torque, links = np.outer(a @ factors, factors).ravel(), mechanism.torque(q, v, a).reshape(a.size, -1)
    residual = motor_torque - links @ np.linalg.lstsq(links, motor_torque, rcond=None)[0]
    return bool(np.linalg.norm(residual) > NEGLIGIBLE * np.linalg.norm(motor_torque))


def place_term(term: Term, joint: str, is_prismatic: bool = False) -> Term:
    """Place a term at a joint."""
    return place_effect(type(term), joint, is_prismatic)(**term.nonlinear_values)


def check_places(terms: Sequence[Term], joints: Sequence[str]) -> None:
    """Refuse terms at unknown joints."""
    for term in terms:
        if not isinstance(term, Links) and not set(list_loads(term.at)) <= set(joints):
            if not any(joints):
                raise UserError(f"{term.id} is at a joint of an arm, a pendulum has one joint: use the effect itself")
            remedy = f"place it, place_term(term, {joints[0]!r})"
            raise UserError(f"{term.id} is at none of the joints {', '.join(joints)}: {remedy}")


def list_friction_terms(mechanism: Mechanism) -> tuple[Term, ...]:
    """Return viscous and Coulomb friction at each joint."""
    joints = zip(mechanism.joints, mechanism.is_prismatic, strict=True)
    return tuple(place_term(term, joint, is_prismatic) for joint, is_prismatic in joints for term in FRICTION)


def list_base_terms(mechanism: Mechanism) -> tuple[Term, ...]:
    """Return the base terms: links, or inertia and gravity, with viscous and Coulomb friction."""
    return arrange_terms(list_friction_terms(mechanism), mechanism) if isinstance(mechanism, LinkedMechanism) else BASE


def arrange_terms(terms: Sequence[T], mechanism: Mechanism) -> tuple[T | Links, ...]:
    """Return the terms of a model, with the links of a linked mechanism in front."""
    return (Links(mechanism), *terms) if isinstance(mechanism, LinkedMechanism) else tuple(terms)


def find_mechanism(terms: Sequence[object]) -> Mechanism:
    """Return the mechanism of a model from its first term: that of the links, else a pendulum."""
    return terms[0].mechanism if terms and isinstance(terms[0], Term) else PENDULUM


def find_linked_mechanism(terms: Sequence[object]) -> LinkedMechanism:
    """Return the mechanism of terms with links."""
    mechanism = find_mechanism(terms)
    assert isinstance(mechanism, LinkedMechanism)
    return mechanism


def list_effects(mechanism: Mechanism) -> dict[str, type[Term]]:
    """Return the effects that the joints of a mechanism can have, by id."""
    return list_joint_effects() if isinstance(mechanism, LinkedMechanism) else list_nameable()


def list_joint_effects() -> dict[str, type[Term]]:
    """Return the library effects of a joint with links, its rotor, and the coupling of two joints, by id."""
    effects = {id: effect for id, effect in list_nameable().items() if is_possible_at_joint(effect)}
    return effects | {kind.id: kind for kind in (Rotor, Coupling)}


def place_effects(kinds: Iterable[type[Term]], mechanism: Mechanism) -> list[type[Term]]:
    """Place effects at each joint where they are possible, and couplings at each pair of adjacent joints.

    A rotor is possible where link parameters do not explain its inertia.

    Effects that are already at a joint are kept.
    """
    kinds = list(kinds)
    if not isinstance(mechanism, LinkedMechanism):
        return kinds
    joints = zip(mechanism.joints, mechanism.is_prismatic, strict=True)
    single = [kind for kind in kinds if kind is not Coupling and not kind.at]
    effects = [
        place_effect(kind, joint, is_prismatic)
        for joint, is_prismatic in joints
        for kind in single
        if is_possible_at_joint(kind, is_prismatic) and (kind is not Rotor or has_separate_rotor(joint, mechanism))
    ]
    return [*effects, *(list_couplings(mechanism) if Coupling in kinds else ()), *(kind for kind in kinds if kind.at)]


def find_kind(text: str, mechanism: Mechanism, library: Mapping[str, type[Term]] | None = None) -> type[Term]:
    """Find an effect or table by name: `stribeck`, at a joint `stribeck@elbow` or `coupling@elbow,-wrist`.

    `library` holds the allowed effects at joints by id, by default all effects and tables.

    Raises:
        ValueError: if effect or joint is unknown; the message names the nearest.
    """
    if not isinstance(mechanism, LinkedMechanism):
        return find_addition(text)
    joints, (id, _, at) = mechanism.joints, text.partition("@")
    if id != Coupling.id:
        kind, joint = parse_effect(text, joints, library or list_joint_effects() | TABLES, mechanism.prismatic_joints)
        if kind is Rotor and not has_separate_rotor(joint, mechanism):
            raise UserError(f"{id} at '{joint}' is part of the link parameters: leave it out")
        return place_effect(kind, joint, mechanism.is_prismatic[joints.index(joint)])
    pair = [find("joint", joint, {name: name for name in joints}) for joint in list_loads(at)]
    _refuse_prismatic(Coupling, pair, mechanism.prismatic_joints)
    if len(pair) != 2 or at.startswith("-"):
        example = f"{id}@{joints[0]},{joints[-1]}"
        raise UserError(f"'{text}' should name two joints, such as {example}, with - for the second")
    return choose_coupling(at, mechanism)


def find_kinds(
    names: Iterable[str], mechanism: Mechanism, library: Mapping[str, type[Term]] | None = None
) -> list[type[Term]]:
    """Find effects by name: `stribeck` at each joint where it is possible, `stribeck@elbow` at this joint.

    `library` holds the allowed effects by id, by default those of the library.
    """
    names, library = list(names), list_effects(mechanism) if library is None else library
    label = "effect of joints" if isinstance(mechanism, LinkedMechanism) else "effect"
    everywhere = [find(label, name, library) for name in names if "@" not in name]
    return [*place_effects(everywhere, mechanism), *(find_kind(name, mechanism) for name in names if "@" in name)]


def parse_effect(
    text: str,
    joints: Sequence[str],
    library: Mapping[str, type[Term]] | None = None,
    prismatic_joints: Collection[str] = (),
) -> tuple[type[Term], str]:
    """Parse effect and joint of `stribeck@elbow`; `library` holds the allowed effects, by default all of joints."""
    id, at, joint = text.partition("@")
    if library is None and id in (Coupling.id, Rotor.id, *MEASURED):
        raise UserError(f"{id} is nothing that the simulator here has: leave it out")
    effect = list_nameable().get(id)
    if effect is not None and not effect.is_decentralised:
        raise UserError(f"{id} is no effect of one joint's motion and torque alone: it cannot sit at a joint of an arm")
    if not at:
        raise UserError(f"'{text}' should say at which joint: {text}@{joints[0]}, for one")
    joint = find("joint", joint, {name: name for name in joints})
    kind = find("effect", id, library or list_joint_effects())
    _refuse_prismatic(kind, [joint], prismatic_joints)
    return kind, joint


def _refuse_prismatic(kind: type[Term], joints: Iterable[str], prismatic_joints: Collection[str]) -> None:
    for joint in joints:
        if joint in prismatic_joints and not is_possible_at_joint(kind, is_prismatic=True):
            raise UserError(f"{kind.id} is of joints that turn: it cannot be at '{joint}', which slides")


@dataclass(frozen=True)
class Links(Term):
    """Rigid links as a term: one column per base parameter, which depends on the motion of all joints."""

    mechanism: LinkedMechanism = field()  # type: ignore[misc]  # in the place of a class variable

    id = "links"
    law = "M(q) q'' + C(q, q') q' + g(q)"
    kind = "inertial"

    @cached_property
    def columns(self) -> tuple[Column, ...]:
        """Return one column per base parameter; `LinkedMechanism` has the regressors."""
        return tuple(Column(parameter.name, parameter.unit) for parameter in self.mechanism.base)

    @property
    def nonlinear_values(self) -> dict[str, float]:
        """Return no parameters."""
        return {}

    def list_angle_functions(self, at: str) -> tuple[str, ...]:
        """Return the angle functions of a joint's gravity, if it is independent of the other joints."""
        joint = self.mechanism.joints.index(at)
        first, second = np.random.default_rng(0).uniform(-np.pi, np.pi, (2, DRAWS, len(self.mechanism.joints)))
        second[:, joint] = first[:, joint]
        torque, other = (self.mechanism.torque(q, 0 * q, 0 * q)[:, joint] for q in (first, second))  # (DRAWS, P)
        if not np.any((np.abs(torque - other).max(axis=0) < NEGLIGIBLE) & (np.abs(torque).max(axis=0) > NEGLIGIBLE)):
            return ()
        return ("one",) if self.mechanism.is_prismatic[joint] else ("sine", "cosine")
