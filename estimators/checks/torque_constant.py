"""Torque constant of a drive that logs its current, from known loads.

With current i instead of torque, tau = K i, every parameter comes out per ampere: motion alone cannot tell K. A load of
known inertia dI and gravity dmgl, which differs from recording to recording, can,

    i = (1/K) (dI q'' + dmgl sin q) + (1/K) (I q'' + mgl sin q + friction),

as the torque of the known loads is a column like any other, fitted with all else that lies between torque and log. A
load torque that was measured at the output, and that varies, belongs to that column: a single recording is enough.

Source: Gautier and Briot, Journal of Dynamic Systems, Measurement, and Control 136(5), 2014 (drive gains of robots from
known payloads).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.channel import ChannelFits
from estimators.checks.channel_rows import DRIVEN, NONE, compute_driven_share, is_brake
from estimators.data.fits import fit_terms
from estimators.data.regression_data import RegressionData
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import remove_unit_inertia
from estimators.regression.least_squares import IdentificationError
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env.physics import Estimate, Model
from pendulum_env.recording import NEWTON_METRE, Recording, TorqueConstant
from pendulum_env.units import is_of_torque

LEAST = 5.0  # standard errors that the constant has to be from none


def find_torque_unit(recordings: Sequence[Recording]) -> str:
    """Return the common unit of torque of recordings."""
    units = list(dict.fromkeys(recording.torque_unit for recording in recordings))
    if len(units) > 1:
        one, other = (next(r.name for r in recordings if r.torque_unit == unit) for unit in units[:2])
        raise IdentificationError(
            f"torque is in {units[0]} in {one} and in {units[1]} in {other}: read all recordings alike, with a gain or "
            "with *? for the torque"
        )
    return units[0]


def add_torque_constant(
    model: Model, data: TorqueWindows, fit: Callable[[TorqueWindows], Model] | None = None
) -> Model:
    """Return a model fitted to data, in the unit of their torque, with the torque constant and its standard error.

    `fit` finds the parameters in data under another constant; by default it fits the model's terms as they are.
    """
    recording = data.windows[0].recording
    constant = recording.torque_constant
    if constant is None:
        return remove_unit_inertia(model.convert_units(recording.units))
    fit = fit or (lambda own: fit_terms(RegressionData(own, ()), model.terms)[0])
    return widen_by_constant(model, constant, fit(data), fit(data.with_torque(1 + constant.std / constant.value)))


def widen_by_constant(model: Model, constant: TorqueConstant, here: Model, there: Model) -> Model:
    """Add the error of the torque constant to standard errors; it changes parameters from `here` to `there`.

    The error of the constant and those of a fit that is given it have nothing to do with each other, since the constant
    is fitted beside the columns of that fit: squares add up.
    """
    estimates = {}
    for name, own in model.estimates.items():
        if "." in name and name not in {column.name for column in model.columns}:  # a nonlinear parameter, searched for
            moved = own.value * constant.std / constant.value if is_of_torque(own.unit) else 0.0
        else:
            moved = there.estimates[name].value - here.estimates[name].value
        estimates[name] = replace(own, std=float(np.hypot(own.std, moved)))
    known = Estimate(constant.value, constant.std, constant.unit)
    return replace(model, estimates=estimates, torque_constant=known)


def estimate_torque_constant(recordings: Sequence[Recording]) -> TorqueConstant | Finding:
    """Return the torque constant from recordings of a current under known loads, or why it is unknown.

    A recording without a known load counts as one without a load.

    Raises:
        IdentificationError: if the recordings hold too little motion.
    """
    unit = find_torque_unit(recordings)
    loads = [recording.load or NONE for recording in recordings]
    by_load_torque = any(recording.has_varying_load for recording in recordings)
    if len(set(loads)) < 2 and not by_load_torque:
        return explain_unknown_constant(Kind.LOADS_UNKNOWN if loads[0] == NONE else Kind.LOADS_EQUAL, unit)
    fits = ChannelFits.from_recordings(recordings)
    if fits is None:
        return explain_unknown_constant(Kind.CONSTANT_TOO_SHORT, unit)
    moved = {loads[k] for k in np.unique(fits.data.recording_of_window[fits.rows])}
    if len(moved) < 2 and not by_load_torque:
        return explain_unknown_constant(Kind.ONE_LOAD_MOVED, unit, loads=Quantity(len(set(loads))))
    is_plain = compute_driven_share(fits.data, fits.data.torque()) > DRIVEN or is_brake(fits.data)
    share, std = (fits if is_plain else fits.with_motor_friction()).delay_fit.gain  # 1/K
    if abs(share) <= LEAST * std:
        return explain_unknown_constant(Kind.CONSTANT_UNCERTAIN, unit, inverse=Quantity(share, std, f"{unit}/(N m)"))
    if share < 0:
        turned = ("load_torque",) if by_load_torque else ()
        negative = Quantity(1 / share, std / share**2, f"{NEWTON_METRE}/{unit}")
        return replace(
            explain_unknown_constant(Kind.CONSTANT_NEGATIVE, unit, torque_constant=negative), parameters=turned
        )
    return TorqueConstant(1 / share, std / share**2, unit, len(moved), by_load_torque)


def explain_unknown_constant(kind: Kind, unit: str, **numbers: Quantity) -> Finding:
    """Return why the torque constant of what was logged in a unit is unknown."""
    return Finding(kind, {"torque_constant": Quantity(np.nan, unit=f"{NEWTON_METRE}/{unit}")} | numbers)


def find_gain_doubts(model: Model, constant: TorqueConstant, data: TorqueWindows) -> list[Finding]:
    """Find what the torque constant of a model in N m leaves open in the data that it was fitted to."""
    found, share = [], compute_driven_share(data, data.torque())
    if share > DRIVEN or is_brake(data):
        kind = Kind.LOAD_BRAKES if is_brake(data) else Kind.GEAR_LOSS_UNKNOWN
        known = Quantity(constant.value, constant.std, constant.unit)
        found.append(Finding(kind, {"share": Quantity(share), "torque_constant": known}))
    if constant.of != "A" and "viscous" in model.estimates:
        most = model.estimates["viscous"].value / constant.value
        found.append(Finding(Kind.BACK_EMF, {"back_emf": Quantity(most, unit=f"{constant.of} s/rad")}))
    return found
