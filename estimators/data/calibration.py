"""Calibration: torque of recordings in N m, by a torque constant, known loads, or the known parameter of a swing."""

from collections.abc import Mapping, Sequence

from estimators import in_loop
from estimators.checks.torque_constant import estimate_torque_constant, explain_unknown_constant, find_torque_unit
from estimators.findings import Finding, Kind
from estimators.free_swings import fit_inertia, scale_swing, scale_swings
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics import Model, ModelError
from pendulum_env.recording import NEWTON_METRE, PER_INERTIA, Recording, TorqueConstant
from pendulum_env.settings import Blank, format_setting

Recordings = tuple[Recording, ...]


def calibrate(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording],
    constant: TorqueConstant | None,
    known: Mapping[str, float],
) -> tuple[Recordings, Recordings, Finding | None]:
    """Return recordings in N m, and a finding if the torque constant is unknown; see `FitData.from_recordings`.

    Torque of a controller with an integral part stays in the unit of the log: the state of the integral is unknown.
    """
    every, count = (*recordings, *holdout), len(recordings)
    driven, doubt = [own for own in every if not own.is_free], None
    if any(own.has_unknown_integral for own in every):
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
    return tuple(own.convert_to_newton_metres(found) for own in every), None


def _scale_swings(recordings: Recordings, inertia: float, torque_unit: str) -> Recordings:
    """Return the recordings, with free swings scaled by an inertia."""
    return tuple(scale_swing(recording, inertia, torque_unit) for recording in recordings)


def convert_to_model_unit(model: Model, recordings: Sequence[Recording]) -> Recordings:
    """Return recordings as a model takes them: in its unit of torque, with goals that are held or run on.

    Raises:
        IdentificationError: if a current is to be turned into torque, and nothing tells the torque constant.
        ModelError: if the model is of a current and the recordings are not.
    """
    driven, inertia = [recording for recording in recordings if not recording.is_free], dict[str, float]()
    if driven and model.torque_unit == PER_INERTIA:
        raise ModelError(
            f"the model is relative to the inertia, and {driven[0].name} has torque: compare it with free swings, or "
            f"identify it with {format_setting('fixed', {'inertia': Blank('VALUE')})}"
        )
    if len(driven) < len(recordings):
        inertia = {"inertia": model.estimates["inertia"].value}
        unit = find_torque_unit(driven) if driven else model.torque_unit
        recordings = [scale_swing(own, inertia["inertia"], unit) for own in recordings]
    unit, known, constant = find_torque_unit(recordings), model.torque_constant, None
    if unit != model.torque_unit:
        if model.torque_unit != NEWTON_METRE:
            raise ModelError(f"the model is per {model.torque_unit}, and the recordings are in {unit}: read them alike")
        if known is not None and known.unit == f"{NEWTON_METRE}/{unit}":
            constant = TorqueConstant(known.value, known.std, unit)
        recordings, _, doubt = calibrate(recordings, (), constant, inertia)
        if doubt is not None:
            raise IdentificationError(
                f"the model is in {NEWTON_METRE}, and the recordings are in {unit} with an unknown torque constant: "
                "record under known loads that differ, or identify the model with a torque constant"
            )
    return in_loop.decide_goals(recordings)
