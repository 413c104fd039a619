"""The torque constant of a drive that logs its current, from loads of known size.

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

from estimators.checks.channel import DRIVEN, NONE, ChannelFits, is_brake
from estimators.free_swings import as_read
from estimators.regression.equations import IdentificationError
from estimators.selection.data import PreparedData, fit_terms
from estimators.weak_form.dataset import Dataset
from pendulum_env.physics import Estimate, Model
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE, TorqueConstant
from pendulum_env.words import plus_minus

LEAST = 5.0  # standard errors that the constant has to be from none
LOGGED = {"A": "a current", "V": "a voltage", "duty": "a duty cycle"}


def unit_of(recordings: Sequence[Recording]) -> str:
    """The unit that the torque of all recordings is in.

    Raises:
        IdentificationError: if they differ.
    """
    units = list(dict.fromkeys(recording.torque_unit for recording in recordings))
    if len(units) > 1:
        one, other = (next(r.name for r in recordings if r.torque_unit == unit) for unit in units[:2])
        raise IdentificationError(
            f"torque is in {units[0]} in {one} and in {units[1]} in {other}: read all recordings alike, with a gain or "
            "with *? for the torque"
        )
    return units[0]


def told(model: Model, data: Dataset, fit: Callable[[Dataset], Model] | None = None) -> Model:
    """A model that was fitted to data, in the unit of their torque, with the torque constant and what it errs by.

    Args:
        model: in which nothing is said of either.
        data: what it was fitted to.
        fit: finds parameters of the same names in data, by which it is seen what another constant makes of them; if not
            given, the model's terms are fitted as they are.
    """
    recording = data.windows[0].recording
    constant = recording.torque_constant
    if constant is None:
        return as_read(model.per(recording.torque_unit))
    fit = fit or (lambda own: fit_terms(PreparedData(own, ()), model.terms)[0])
    return widened(model, constant, fit(data), fit(data.with_scaled_torque(1 + constant.std / constant.value)))


def widened(model: Model, constant: TorqueConstant, here: Model, there: Model) -> Model:
    """A model whose standard errors include that of the torque constant, which moves parameters from `here` to `there`.

    The error of the constant and those of a fit that is given it have nothing to do with each other, since the constant
    is fitted beside the columns of that fit: squares add up.
    """
    estimates = {}
    for name, own in model.estimates.items():
        if "." in name and name not in {column.name for column in model.columns}:  # a nonlinear parameter, searched for
            moved = own.value * constant.std / constant.value if own.unit.startswith(NEWTON_METRE) else 0.0
        else:
            moved = there.estimates[name].value - here.estimates[name].value
        estimates[name] = replace(own, std=float(np.hypot(own.std, moved)))
    known = Estimate(constant.value, constant.std, constant.unit)
    return replace(model, estimates=estimates, torque_constant=known)


def torque_constant(recordings: Sequence[Recording]) -> TorqueConstant | str:
    """Torque constant from recordings of a current under known loads, or in a sentence why there is none.

    A recording of which no load is known counts as one without a load.

    Raises:
        IdentificationError: if the recordings hold too little motion.
    """
    unit = unit_of(recordings)
    loads = [recording.load or NONE for recording in recordings]
    by_load_torque = any(recording.has_varying_load for recording in recordings)
    name = "torque constant" if unit == "A" else "torque gain"
    unknown = f"the {name} is not known, and every parameter is per {unit}"
    if len(set(loads)) < 2 and not by_load_torque:
        hung = "known loads that differ are needed" if loads[0] == NONE else "all recordings have the same load"
        return (
            f"{unknown}: the log has {LOGGED.get(unit, unit)} for the torque, and {hung}; record with another known "
            "load, or without any, and give `load` in the study; or log the torque at the output as `load_torque`"
        )
    fits = ChannelFits.of(recordings)
    if fits is None:
        return f"{unknown}: too little of the motion is clear of the ends of the recordings; record longer"
    moved = {loads[k] for k in np.unique(fits.data.recording_of_window[fits.rows])}
    if len(moved) < 2 and not by_load_torque:
        return (
            f"{unknown}: of {len(set(loads))} known loads only one was moved; move the joint under each of them, clear "
            "of stick"
        )
    is_plain = driven(fits.data) > DRIVEN or is_brake(fits.data)
    share, std = (fits if is_plain else fits.rubbing()).delayed.gain  # 1/K
    if abs(share) <= LEAST * std:
        return (
            f"{unknown}: its inverse is {plus_minus(share, std)} {unit}/(N m) by the known loads; take loads that "
            "differ more, or move further"
        )
    if share < 0:
        return (
            f"{unknown}: it would be negative, {plus_minus(1 / share, std / share**2)} N m/{unit}; turn "
            f"{'load_torque, ' if by_load_torque else ''}torque or position round with a minus sign"
        )
    return TorqueConstant(1 / share, std / share**2, unit, len(moved), by_load_torque)


def of_the_drive(model: Model, constant: TorqueConstant, data: Dataset) -> list[str]:
    """What a torque constant leaves open, in sentences.

    Args:
        model: in N m, by it.
        constant: that was found.
        data: what it was fitted to.
    """
    said = []
    share = driven(data)
    name = "torque constant" if constant.of == "A" else "torque gain"
    if share > DRIVEN or is_brake(data):
        cause = (
            "the load torque opposes the motion nearly always"
            if is_brake(data)
            else (f"the motor pushes along the motion {share:.0%} of the time")
        )
        said.append(
            f"{cause}: what its gears lose of its torque and the "
            f"{name} are one number, of which {constant.value:.4g} {constant.unit} is the product; a weight that is "
            "let down slowly, so that it turns the motor, would tell them apart"
        )
    if constant.of != "A" and "viscous" in model.estimates:
        most = model.estimates["viscous"].value / constant.value
        said.append(
            f"the log has {LOGGED[constant.of]}: back-EMF, {name} times k_e q', is part of the viscous friction, and "
            f"k_e is {most:.3g} {constant.of} s/rad at most"
        )
    return said


def driven(data: Dataset) -> float:
    """Share of the motion that the torque pushes along."""
    return float(np.mean(data.torque() * data.samples.velocity > 0))
