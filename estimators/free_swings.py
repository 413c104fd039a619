"""Free swings: recordings in which no torque is applied: the motion tells parameters relative to the inertia.

The inertia I is known, or it is 1. Then its torque stands for that of a motor,

    -I q'' = mgl sin q + b q' + fc sgn q' + ...

With I = 1 all torques are divided by the inertia: gravity and Coulomb friction are in rad/s^2, viscous friction in 1/s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.equations import IdentificationError
from estimators.selection.columns import depends_on_torque
from estimators.selection.regression import Regression
from estimators.weak_form.dataset import prepare
from pendulum_env._typing import Array
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics.limits import limited_term
from pendulum_env.recording import Load, Recording
from pendulum_env.recording.record import NEWTON_METRE, PER_INERTIA
from pendulum_env.words import listing

NONE = Load(0.0, 0.0)


def swing(recording: Recording, inertia: float, torque_unit: str) -> Recording:
    """Scale a free swing by an inertia in a unit of torque; return any other recording as it is."""
    if not recording.is_free:
        return recording
    still = np.zeros(len(recording))
    return replace(recording, torque=still, torque_unit=torque_unit, torque_constant=None, known_inertia=inertia)


def known_values(terms: Sequence[Term]) -> dict[str, float]:
    """Return the linear parameters of some terms that are known, by name."""
    return {column.name: column.least for term in terms for column in term.columns if column.is_known}


def known_by(model: Model, fixed: Mapping[str, float] | None) -> dict[str, float]:
    """Return the values that scale free swings in a refit of a model: fixed ones, and its inertia in kg m^2."""
    inertia = model.estimates.get("inertia") if model.torque_unit == NEWTON_METRE else None
    return ({"inertia": inertia.value} if inertia is not None else {}) | dict(fixed or {})


def scale_swings(recordings: Sequence[Recording], known: Mapping[str, float]) -> float:
    """Return the inertia [kg m^2] of free swings: known, or by another known parameter of the base; 0 if none is.

    An inertia of 1 is that of parameters relative to it.

    Raises:
        IdentificationError: if the recordings hold too little motion, or their known loads differ and nothing else is
            known.
    """
    if (inertia := known.get("inertia", 1.0)) != 1.0:
        return inertia
    others = [k for k, term in enumerate(BASE) if k and known.get(term.id)]
    if others:
        return float(abs(known[BASE[others[0]].id] / _ratios(recordings)[others[0]]))
    loads = list(dict.fromkeys(recording.load or NONE for recording in recordings))
    if len(loads) > 1:
        names, inertia = listing([recording.name for recording in recordings]), _inertia_by_loads(recordings, loads)
        raise IdentificationError(
            f"{names}: no torque is applied, and their known loads differ: fix the inertia of the joint without load, "
            f"--fix inertia={inertia:.4g} by these loads"
        )
    return 0.0


def _inertia_by_loads(recordings: Sequence[Recording], loads: Sequence[Load]) -> float:
    """Return the inertia I [kg m^2] that known loads determine.

    Under a load of inertia dI and gravity dmgl, gravity over inertia is g = (mgl + dmgl) / (I + dI).
    """
    groups = [[recording for recording in recordings if (recording.load or NONE) == load] for load in loads]
    g = np.array([_ratios(group)[1] for group in groups])
    y = [load.gravity - ratio * load.inertia for load, ratio in zip(loads, g.tolist(), strict=True)]
    return float(np.linalg.lstsq(np.column_stack([g, -np.ones(len(g))]), y, rcond=None)[0][0])


def _ratios(recordings: Sequence[Recording]) -> Array:
    """Return the parameters of the base (4,) over the inertia."""
    data = prepare([swing(recording, 1.0, PER_INERTIA) for recording in recordings])
    return Regression(data).solve(relative_terms(BASE, PER_INERTIA))


def fitted_inertia(recordings: Sequence[Recording]) -> float:
    """Return the inertia [kg m^2] by a fit of the base model to recordings with torque; 0 if they are too short."""
    try:
        return abs(float(Regression(prepare(recordings)).solve(BASE)[0]))
    except IdentificationError:
        return 0.0


def relative_terms(terms: Sequence[Term], torque_unit: str) -> tuple[Term, ...]:
    """Return terms whose inertia is 1 where torque is relative to it; other terms as they are.

    Raises:
        IdentificationError: if there is no inertia among the terms.
    """
    if torque_unit != PER_INERTIA:
        return tuple(terms)
    if "inertia" not in {term.id for term in terms}:
        raise IdentificationError("no torque is applied: a model of free swings needs the term inertia")
    return tuple(limited_term(term, {"inertia": (1.0, 1.0)}) for term in terms)


def as_read(model: Model) -> Model:
    """Return a model without the limit of an inertia of 1, which its unit of torque tells."""
    if model.torque_unit != PER_INERTIA:
        return model
    bare = {term: getattr(type(term), "bare", (type(term),))[0]() for term in model.terms if term.id == "inertia"}
    return replace(model, terms=tuple(bare.get(term, term) for term in model.terms))


def needs_torque(kind: type[Term]) -> bool:
    """Return whether an effect shows only under torque: it changes the torque of a motor, or lies behind the motor."""
    return kind.link or depends_on_torque(kind())
