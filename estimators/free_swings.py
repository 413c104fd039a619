"""Free swings: recordings without applied torque, which determine parameters relative to the inertia.

The torque of the inertia I replaces that of a motor,

    -I q'' = mgl sin q + b q' + fc sgn q' + ...

I is given, or follows from another known parameter. Otherwise I = 1, and all torques are divided by the inertia:
gravity and Coulomb friction are in rad/s^2, viscous friction in 1/s.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.regression.least_squares import IdentificationError
from estimators.weak_form.columns import is_torque_dependent
from estimators.weak_form.preparation import prepare_windows
from estimators.weak_form.torque_rows import TorqueRows
from pendulum_env._typing import Array
from pendulum_env.formatting import join_words
from pendulum_env.physics import BASE, Model, Term
from pendulum_env.physics.limits import limit_term
from pendulum_env.recording import NEWTON_METRE, PER_INERTIA, Load, Recording
from pendulum_env.settings import Blank, format_setting
from pendulum_env.units import is_of_torque

NO_LOAD = Load(0.0, 0.0)


def scale_swing(recording: Recording, inertia: float, torque_unit: str) -> Recording:
    """Return a free swing with a known inertia, zero torque, and a unit of torque; other recordings are unchanged.

    Its load torque and torque constant are removed.
    """
    if not recording.is_free:
        return recording
    without_torque = replace(recording, torque=np.zeros(len(recording)), load_torque=None)
    return replace(without_torque, torque_unit=torque_unit, torque_constant=None, known_inertia=inertia)


def find_known_values(terms: Sequence[Term]) -> dict[str, float]:
    """Return the linear parameters of some terms that are known, by name."""
    return {column.name: column.least for term in terms for column in term.columns if column.is_known}


def find_scaling_values(model: Model, fixed: Mapping[str, float] | None) -> dict[str, float]:
    """Return the values that scale free swings in a refit of a model: fixed ones, and its inertia in kg m^2."""
    inertia = model.estimates.get("inertia") if model.torque_unit == NEWTON_METRE else None
    return ({"inertia": inertia.value} if inertia is not None else {}) | dict(fixed or {})


def scale_swings(recordings: Sequence[Recording], known: Mapping[str, float]) -> float | None:
    """Return the inertia [kg m^2] of free swings, by a known parameter of the base; None without a known parameter.

    Raises:
        IdentificationError: if known loads differ, or the known parameter contradicts the motion.
    """
    if (inertia := known.get("inertia")) is not None:
        return inertia
    names = join_words([recording.name for recording in recordings])
    loads = list(dict.fromkeys(recording.load or NO_LOAD for recording in recordings))
    if len(loads) > 1:
        raise IdentificationError(
            f"{names}: no torque is applied, and their known loads differ: fix the inertia of the joint without load, "
            f"{format_setting('fixed', {'inertia': Blank('VALUE')})}"
        )
    if (name := _find_scaling_parameter(known)) is None:
        return None
    ratio = dict(zip((term.id for term in BASE), _compute_ratios(recordings).tolist(), strict=True))[name]
    total = known[name] + (loads[0].gravity if name == "gravity" else 0.0)
    if total * ratio <= 0 or (inertia := total / ratio - loads[0].inertia) <= 0:
        raise IdentificationError(
            f"{names}: the free motion has a {name} of {ratio:.3g} times the inertia, which contradicts {name} = "
            f"{known[name]:g}: fix another parameter, {format_setting('fixed', {'inertia': Blank('VALUE')})}"
        )
    return inertia


def _find_scaling_parameter(known: Mapping[str, float]) -> str | None:
    """Return the known parameter of the base, other than the inertia, that scales free swings; None if none does."""
    if "inertia" in known:
        return None
    return next((term.id for term in BASE if known.get(term.id)), None)


def _compute_ratios(recordings: Sequence[Recording]) -> Array:
    """Return the parameters of the base (4,) over the inertia, both with the known load."""
    swings = [scale_swing(recording, 1.0, PER_INERTIA) for recording in recordings]
    return TorqueRows(prepare_windows(swings)).fits.solve(make_swing_terms(BASE, swings))


def fit_inertia(recordings: Sequence[Recording]) -> float:
    """Return the inertia [kg m^2] by a fit of the base model to recordings with torque; 0 if they are too short."""
    try:
        return prepare_windows(recordings).base_inertia
    except IdentificationError:
        return 0.0


def make_swing_terms(terms: Sequence[Term], recordings: Sequence[Recording]) -> tuple[Term, ...]:
    """Return terms for a fit of free swings, with a fixed inertia; unchanged for other recordings.

    Noise of the acceleration would bias an inertia that is fitted to a small known torque. The known parameter is
    therefore free, and `restore_known` scales the model to it.

    Raises:
        IdentificationError: if the terms have no inertia.
    """
    known = find_known_values(terms)
    if "inertia" in known or not all(recording.known_inertia for recording in recordings):
        return tuple(terms)
    if "inertia" not in {term.id for term in terms}:
        raise IdentificationError("no torque is applied: a model of free swings needs the term inertia")
    inertia, name = recordings[0].known_inertia, _find_scaling_parameter(known)
    limits = {"inertia": (inertia, inertia)} | ({name: (-np.inf, np.inf)} if name else {})
    return tuple(limit_term(term, limits) for term in terms)


def restore_known(model: Model, terms: Sequence[Term], recordings: Sequence[Recording]) -> Model:
    """Scale a model of `make_swing_terms` to the known parameter of the original terms; return other models unchanged.

    Motion without torque determines all parameters theta, with the known load o, up to a factor: (theta + o) (c + o_c)
    / (theta_c + o_c) - o if c is the known value of theta_c. The known parameter gets a standard error of zero.
    """
    name = _find_scaling_parameter(known := find_known_values(terms))
    if name is None or not all(recording.known_inertia for recording in recordings):
        return model
    load, names = recordings[0].load or NO_LOAD, list(model.estimates)
    old_estimates = [*model.estimates.values()]
    offset = np.array([{"inertia": load.inertia, "gravity": load.gravity}.get(key, 0.0) for key in names])
    with_load, k = np.array([estimate.value for estimate in old_estimates]) + offset, names.index(name)
    linear = {column.name for column in model.columns if is_of_torque(column.unit)}
    is_scaled = np.array([key in linear for key in names])
    factor = (known[name] + offset[k]) / with_load[k]
    jacobian = np.diag(np.where(is_scaled, factor, 1.0))
    jacobian[:, k] -= np.where(is_scaled, factor * with_load / with_load[k], 0.0)
    covariance = jacobian @ model.assumed_covariance @ jacobian.T
    covariance[k], covariance[:, k] = 0.0, 0.0
    values = np.where(is_scaled, factor * with_load - offset, with_load)
    values[k] = known[name]
    estimates = {
        key: replace(estimate, value=float(value))
        for key, estimate, value in zip(names, old_estimates, values, strict=True)
    }
    original = {term.id: term for term in terms if term.id in ("inertia", name)}
    restored = tuple(original.get(term.id, term) for term in model.terms)
    return replace(model, terms=restored, estimates=estimates).with_errors(names, covariance)


def remove_unit_inertia(model: Model) -> Model:
    """Return a model in units per inertia without the limit of its inertia to 1; other models are unchanged."""
    if model.torque_unit != PER_INERTIA:
        return model
    unlimited = {term: getattr(type(term), "bare", (type(term),))[0]() for term in model.terms if term.id == "inertia"}
    return replace(model, terms=tuple(unlimited.get(term, term) for term in model.terms))


def is_torque_needed(kind: type[Term]) -> bool:
    """Return whether an effect acts only under torque: it changes the torque of a motor, or lies behind the motor."""
    return kind.link or is_torque_dependent(kind())
