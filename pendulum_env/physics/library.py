"""Library of effects: built-in effects, effects of the user, and effects of installed packages."""

import warnings
from functools import cache
from types import ModuleType

from pendulum_env.errors import UserError
from pendulum_env.lookup import find
from pendulum_env.physics import actuation, friction, potential, sensor, time_varying, transmission
from pendulum_env.physics.base import BASE
from pendulum_env.physics.effect_check import check_effect
from pendulum_env.physics.table import TABLES
from pendulum_env.physics.term import Term
from pendulum_env.plugins import load_plugins

ENTRY_POINTS = "pendulum_ident.effects"
BUILT_IN: tuple[type[Term], ...] = (
    actuation.TorqueOffset,
    potential.GravityTilt,
    friction.CoulombAsymmetry,
    friction.ViscousAsymmetry,
    friction.Stribeck,
    friction.QuadraticDrag,
    friction.LoadDependentFriction,
    friction.PositionDependentFriction,
    potential.Cogging,
    actuation.TorqueRipple,
    potential.Spring,
    actuation.ActuatorLag,
    actuation.DeadTime,
    actuation.TorqueSaturation,
    time_varying.FrictionDrift,
    time_varying.PayloadChange,
    time_varying.PeriodicDisturbance,
    transmission.Backlash,
    transmission.JointFlexibility,
    friction.Presliding,
    sensor.EncoderEccentricity,
    potential.HardStop,
)
MEASURED: dict[str, type[Term]] = {  # effects of measured quantities other than motion and torque
    friction.TemperatureDependentFriction.id: friction.TemperatureDependentFriction
}

_registered: dict[str, type[Term]] = {}


def register(effect: type[Term]) -> type[Term]:
    """Add an effect to the library of this process; usable as a class decorator.

    The class is checked, with each law evaluated on synthetic motion. A class of the same module and name replaces the
    earlier one, for example when a notebook cell runs again.

    Raises:
        UserError: if a field or a law is invalid, or another effect or base term has the same id.
    """
    if effect in _registered.values():
        return effect
    check_effect(effect)
    replaced_ids = {id for id, kind in _registered.items() if _get_full_name(kind) == _get_full_name(effect)}
    used_ids = {term.id for term in BASE} | {built_in.id for built_in in BUILT_IN} | MEASURED.keys()
    if effect.id in used_ids | (_registered.keys() - replaced_ids):
        raise UserError(f"effect id '{effect.id}' is taken: choose another id for {effect.__name__}")
    for id in replaced_ids - {effect.id}:
        del _registered[id]
    _registered[effect.id] = effect
    return effect


def _get_full_name(kind: type[Term]) -> tuple[str, str]:
    return kind.__module__, kind.__qualname__


@cache
def load_installed() -> tuple[type[Term], ...]:
    """Load the effects of installed packages."""
    kinds = []
    for kind in load_plugins(ENTRY_POINTS).values():
        if isinstance(kind, type) and issubclass(kind, Term):
            try:
                check_effect(kind)
                kinds.append(kind)
            except UserError as error:
                warnings.warn(f"the effect {kind.__name__} cannot be loaded: {error}", stacklevel=2)
        elif not isinstance(kind, ModuleType):  # a module registers its effects when it is imported
            warnings.warn(f"{kind!r} is no effect: name a subclass of Term, or a module", stacklevel=2)
    return tuple(kinds)


def effects() -> dict[str, type[Term]]:
    """Return all known effects by id, built-in effects first."""
    return {effect.id: effect for effect in (*BUILT_IN, *load_installed(), *_registered.values())}


def list_nameable() -> dict[str, type[Term]]:
    """Return the effects that a diagnosis may name, by id: the library and `MEASURED`."""
    return effects() | MEASURED


def list_addable() -> dict[str, type[Term]]:
    """Return the terms that can be added to a model, by id: effects and tables."""
    return list_nameable() | TABLES


def effect(id: str) -> type[Term]:
    """Find the effect of an id."""
    return find("effect", id, effects())


def find_addition(id: str) -> type[Term]:
    """Find the effect or table of an id; raises ValueError like `effect`."""
    return find("effect", id, list_addable())


def find_term(id: str) -> type[Term]:
    """Find the base term, effect or table of an id; raises ValueError like `effect`."""
    base = {item.id: type(item) for item in (*BASE, actuation.BackEmf())}
    return base[id] if id in base else find_addition(id)
