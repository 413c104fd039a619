"""Calibration: torque of recordings in N m, by a torque constant, known loads, or the known parameter of a swing."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimators.checks.torque_constant import estimate_torque_constant, explain_unknown_constant, find_torque_unit
from estimators.findings import Finding, Kind
from estimators.free_swings import fit_inertia, scale_swing, scale_swings
from estimators.regression.equations import IdentificationError
from pendulum_env.recording import Recording
from pendulum_env.recording.channel import NEWTON_METRE, PER_INERTIA, TorqueConstant
from pendulum_env.settings import Blank, format_setting

Recordings = tuple[Recording, ...]


def calibrate(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording],
    constant: TorqueConstant | None,
    known: Mapping[str, float],
) -> tuple[Recordings, Recordings, Finding | None]:
    """Return recordings in N m, and a finding if the torque constant is unknown; `FitData.of` says what it raises.

    Torque of a controller with an integral part stays in the unit of the log: the state of the integral is unknown.
    """
    every, count = (*recordings, *holdout), len(recordings)
    driven, doubt = [own for own in every if not own.is_free], None
    if any(own.drive is not None and own.drive.ki and own.torque_unit != NEWTON_METRE for own in every):
        doubt = explain_unknown_constant(Kind.INTEGRAL_CONTROLLER, every[0].torque_unit)
    elif len(driven) == len(every):
        every, doubt = _convert_by_constant(every, count, constant)
    elif all(own.is_free for own in recordings):
        every, doubt = _scale_by_known_value(every, count, driven, known)
    else:
        every, doubt = _convert_by_constant(_scale_swings(every, 0.0, find_torque_unit(driven)), count, constant)
        inertia = known.get("inertia") or fit_inertia([own for own in every[:count] if not own.is_free])
        every = _scale_swings(every, inertia, every[0].torque_unit)
    return every[:count], every[count:], doubt


def _scale_by_known_value(
    every: Recordings, count: int, driven: Sequence[Recording], known: Mapping[str, float]
) -> tuple[Recordings, Finding | None]:
    """Scale free swings by a known parameter, else by an inertia of 1; some held-out recordings may be driven.

    The first recordings, by their count, are fitted.
    """
    inertia = scale_swings(every[:count], known)
    unit = PER_INERTIA if inertia is None else NEWTON_METRE
    if driven and find_torque_unit(driven) != unit:
        raise IdentificationError(
            f"{driven[0].name}: has torque, but no recording that is fitted has any: fit one with torque, or give "
            f"the inertia, {format_setting('fixed', {'inertia': Blank('VALUE')})}, and torque in N m"
        )
    loaded = tuple(own.name for own in every[:count] if own.load is not None)
    doubt = Finding(Kind.RELATIVE_TO_INERTIA, recordings=loaded) if inertia is None else None
    return _scale_swings(every, inertia or 1.0, unit), doubt


def _convert_by_constant(
    every: Recordings, count: int, constant: TorqueConstant | None
) -> tuple[Recordings, Finding | None]:
    """Convert logged currents into torque, by a constant that is known or that loads of the first ones determine."""
    unit = find_torque_unit(every)
    if unit == NEWTON_METRE:
        return every, None
    if constant is not None and constant.of != unit:
        raise IdentificationError(f"torque is in {unit}, but the torque constant is of {constant.of}: convert the log")
    found = constant or estimate_torque_constant(every[:count])
    if isinstance(found, Finding):
        return every, found
    return tuple(_convert_to_newton_metres(own, found) for own in every), None


def _convert_to_newton_metres(recording: Recording, constant: TorqueConstant) -> Recording:
    """Return a recording in N m; the torque constant becomes the gain of its drive."""
    torque, drive = constant.value * recording.torque, recording.drive
    if drive is not None and drive.unit == constant.of:
        drive = replace(drive, gain=constant.value)
    return replace(recording, torque=torque, torque_unit=NEWTON_METRE, torque_constant=constant, drive=drive)


def _scale_swings(recordings: Recordings, inertia: float, torque_unit: str) -> Recordings:
    """Return the recordings, with free swings scaled by an inertia."""
    return tuple(scale_swing(recording, inertia, torque_unit) for recording in recordings)
