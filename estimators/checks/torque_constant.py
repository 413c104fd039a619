"""Torque constant of a motor with logged current, from known loads.

With a current i = tau / K, every parameter is fitted per ampere: motion alone does not determine K. A load of known
inertia dI and gravity dmgl that differs between recordings determines it,

    i = (1/K) (dI q'' + dmgl sin q) + (1/K) (I q'' + mgl sin q + friction).

The torque of the known loads is a column, fitted together with the law of the torque channel. A varying load torque
that is measured at the output belongs to the same column; one recording is then enough.

Source: Gautier and Briot, Journal of Dynamic Systems, Measurement, and Control 136(5), 2014 (torque constants of robots
from known payloads).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.checks.channel import ChannelFits
from estimators.checks.channel_rows import compute_driven_share, is_brake, list_load_friction
from estimators.decisions.criterion import Criterion
from estimators.findings import Finding, Quantity
from estimators.free_swings import NO_LOAD
from estimators.regression.least_squares import IdentificationError
from estimators.signals.motion import get_load_in_newton_metres
from estimators.weak_form.torque_windows import TorqueWindows
from pendulum_env.physics import LOAD, Model
from pendulum_env.recording import NEWTON_METRE, Recording, TorqueConstant


@dataclass(frozen=True)
class UnknownConstant(Finding):
    """Unknown torque constant of a motor with torque logged in another unit than N m.

    Attributes:
        logged: unit of the log, "A" for example.
        loads: number of different known loads; 0 without any.
        moved: number of these under which the joint moved clear of the ends of the recordings.
        inverse: uncertain inverse of the constant; None if it was not estimated.
        constant: negative constant; None otherwise.
        by_load_torque: whether a load torque was logged.
        has_integral: whether a controller has an integral part of unknown state.
    """

    logged: str
    loads: int = 0
    moved: int = 0
    inverse: Quantity | None = None
    constant: Quantity | None = None
    by_load_torque: bool = False
    has_integral: bool = False

    @property
    def is_open(self) -> bool:
        """Return whether other loads or motion would determine the constant."""
        return self.constant is None


@dataclass(frozen=True)
class GearLosses(Finding):
    """Losses of gears that cannot be told from the torque constant.

    Attributes:
        constant: the torque constant.
        share: share of the motion that the motor causes.
        is_braked: whether the load torque nearly always opposes the motion.
    """

    constant: Quantity
    share: float
    is_braked: bool = False

    @property
    def is_open(self) -> bool:
        """Return True: a weight that turns the motor shows the losses."""
        return True


@dataclass(frozen=True)
class BackEmfInFriction(Finding):
    """Back-EMF that is part of the viscous friction; `constant` is its largest constant."""

    constant: Quantity


def find_torque_unit(recordings: Sequence[Recording]) -> str:
    """Return the common unit of torque of recordings; different units raise an `IdentificationError`."""
    units = list(dict.fromkeys(recording.torque_unit for recording in recordings))
    if len(units) > 1:
        first_name, second_name = (next(r.name for r in recordings if r.torque_unit == unit) for unit in units[:2])
        raise IdentificationError(
            f"torque is in {units[0]} in {first_name} and in {units[1]} in {second_name}: read all recordings alike, "
            "with a gain or with *? for the torque"
        )
    return units[0]


def estimate_torque_constant(
    recordings: Sequence[Recording], criterion: Criterion = Criterion()
) -> TorqueConstant | UnknownConstant:
    """Estimate the torque constant from recordings of a current under known loads.

    A recording without a known load counts as unloaded.

    Returns:
        The constant, or a finding with the reason why it is unknown.

    Raises:
        IdentificationError: if units differ or the recordings have too little motion.
    """
    unit = find_torque_unit(recordings)
    loads = [recording.load or NO_LOAD for recording in recordings]
    by_load_torque = any(recording.has_varying_load for recording in recordings)
    if len(set(loads)) < 2 and not by_load_torque:
        return UnknownConstant(unit, 0 if loads[0] == NO_LOAD else 1)
    unknown = UnknownConstant(unit, len(set(loads)), by_load_torque=by_load_torque)
    fits = ChannelFits.from_recordings(recordings, criterion=criterion)
    if fits is None:
        return unknown
    windows = (
        replace(w, samples=replace(w.samples, load=get_load_in_newton_metres(w.recording)))
        for w in fits.rows.data.windows
    )
    data = replace(fits.rows.data, windows=tuple(windows))
    moved_loads = {loads[k] for k in np.unique(data.recording_of_window)}
    if len(moved_loads) < 2 and not by_load_torque:
        return replace(unknown, moved=len(moved_loads))
    inverse, std = _add_load_columns(fits, data).delay_fit.gain  # 1/K
    if abs(inverse) <= criterion.z_score * std:
        return replace(unknown, moved=len(moved_loads), inverse=Quantity(inverse, std, f"{unit}/(N m)"))
    if inverse < 0:
        negative = Quantity(1 / inverse, std / inverse**2, f"{NEWTON_METRE}/{unit}")
        return replace(unknown, moved=len(moved_loads), constant=negative)
    return TorqueConstant(1 / inverse, std / inverse**2, unit, len(moved_loads), by_load_torque)


def _add_load_columns(fits: ChannelFits, data: TorqueWindows) -> ChannelFits:
    """Return the fits with the torque of the known loads as the first column, and friction under these loads.

    Friction of the motor torque is added unless nearly all motion is driven or braked. `data` has the known loads.
    """
    averages, limits = data.window_columns.averages, fits.criterion.columns
    is_driven = compute_driven_share(data, data.torque.recorded) > limits.driven_share
    laws = LOAD, *list_load_friction(data, limits)
    columns = np.column_stack([averages.column(law, averages.samples) for law in laws])
    loaded = replace(fits, phi=np.column_stack([columns * data.weights[:, None], fits.phi]))
    return loaded if is_driven or is_brake(data, limits) else loaded.with_motor_friction()


def find_gain_doubts(
    model: Model, constant: TorqueConstant, data: TorqueWindows, criterion: Criterion = Criterion()
) -> list[Finding]:
    """Find errors that the torque constant of a model in N m may have.

    Gear losses may be part of it if nearly all motion is driven or braked, back-EMF if the log is not in amperes.
    """
    findings, share = list[Finding](), compute_driven_share(data, data.torque.recorded)
    is_braked = is_brake(data, criterion.columns)
    if share > criterion.columns.driven_share or is_braked:
        known = Quantity(constant.value, constant.std, constant.unit)
        findings.append(GearLosses(known, share, is_braked))
    if constant.of != "A" and "viscous" in model.estimates:
        back_emf = model.estimates["viscous"].value / constant.value
        findings.append(BackEmfInFriction(Quantity(back_emf, unit=f"{constant.of} s/rad")))
    return findings
