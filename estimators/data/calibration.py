"""Calibration: torque of recordings in N m, by a torque constant, known loads, or the known parameter of a swing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimators.checks.torque_constant import UnknownConstant, estimate_torque_constant, find_torque_unit
from estimators.data.integrated_zero import set_integrated_zero
from estimators.data.preparation import Recordings, find_preparation
from estimators.data.treatment import Action, Treatment
from estimators.decisions.criterion import Criterion
from estimators.findings import Finding, Quantity
from estimators.free_swings import fit_inertia, scale_swing, scale_swings
from estimators.regression.least_squares import IdentificationError
from pendulum_env.physics import Model, ModelError
from pendulum_env.recording import NEWTON_METRE, PER_INERTIA, Recording, TorqueConstant
from pendulum_env.settings import Blank, format_setting


@dataclass(frozen=True)
class RelativeToInertia(Finding):
    """Parameters relative to the inertia, as no torque is applied; `recordings` have known loads."""

    recordings: tuple[str, ...] = ()


def calibrate(
    recordings: Sequence[Recording],
    holdout: Sequence[Recording],
    constant: TorqueConstant | None,
    known: Mapping[str, float],
    criterion: Criterion,
) -> tuple[Recordings, Recordings, Finding | None]:
    """Return fitted and held-out recordings in N m, and a finding if the torque constant or the inertia is unknown.

    See `FitData.from_recordings` for the arguments. Currents stay under a controller with an integral part of unknown
    state. Beside driven recordings, free swings get the known inertia, or that of a fit to the driven ones.
    """
    combined, count = (*recordings, *holdout), len(recordings)
    doubt: Finding | None = None
    driven = [recording for recording in combined if not recording.is_free]
    if any(r.actuator.has_integral and r.torque_unit != NEWTON_METRE for r in combined):
        doubt = UnknownConstant(combined[0].torque_unit, has_integral=True)
    elif len(driven) == len(combined):
        combined, doubt = _convert_by_constant(combined, count, constant, criterion)
    elif all(recording.is_free for recording in recordings):
        combined, doubt = _scale_by_known_value(combined, count, driven, known)
    else:
        combined = _scale_swings(combined, 0.0, find_torque_unit(driven))
        combined, doubt = _convert_by_constant(combined, count, constant, criterion)
        fitted = [recording for recording in combined[:count] if not recording.is_free]
        inertia = known.get("inertia") or fit_inertia(fitted)
        combined = _scale_swings(combined, inertia, combined[0].torque_unit)
    if known.get("gravity") != 0:
        combined = tuple(map(set_integrated_zero, combined))
    return combined[:count], combined[count:], doubt


def make_constant_finding(constant: TorqueConstant) -> Treatment:
    """Make the finding on the torque constant by which currents are converted."""
    value = Quantity(constant.value, constant.std, constant.unit)
    return Treatment(Action.TORQUE_CONSTANT, {"torque_constant": value})


def _scale_by_known_value(
    combined: Recordings, count: int, driven: Sequence[Recording], known: Mapping[str, float]
) -> tuple[Recordings, Finding | None]:
    """Scale free swings by the inertia from known parameters, else by 1, and return a finding in that case.

    The first `count` of all recordings are fitted, all of them free swings. `driven` are held-out recordings with
    torque, which need the unit of the scaled swings.
    """
    inertia = scale_swings(combined[:count], known)
    unit = PER_INERTIA if inertia is None else NEWTON_METRE
    if driven and find_torque_unit(driven) != unit:
        raise IdentificationError(
            f"{driven[0].name}: has torque, but no recording that is fitted has any: fit one with torque, or give "
            f"the inertia, {format_setting('fixed', {'inertia': Blank('VALUE')})}, and torque in N m"
        )
    loaded = tuple(recording.name for recording in combined[:count] if recording.load is not None)
    doubt = RelativeToInertia(loaded) if inertia is None else None
    return _scale_swings(combined, inertia or 1.0, unit), doubt


def _convert_by_constant(
    combined: Recordings, count: int, constant: TorqueConstant | None, criterion: Criterion
) -> tuple[Recordings, Finding | None]:
    """Convert logged currents into N m by the known constant, or one estimated from the first `count` recordings.

    If it cannot be estimated, return the recordings unchanged and a finding.
    """
    unit = find_torque_unit(combined)
    if unit == NEWTON_METRE:
        return combined, None
    estimated = constant or estimate_torque_constant(combined[:count], criterion)
    if isinstance(estimated, Finding):
        return combined, estimated
    return tuple(recording.convert_to_newton_metres(estimated) for recording in combined), None


def _scale_swings(recordings: Recordings, inertia: float, torque_unit: str) -> Recordings:
    """Return the recordings, with the torque of free swings scaled by an inertia, in a torque unit."""
    return tuple(scale_swing(recording, inertia, torque_unit) for recording in recordings)


def convert_to_model_unit(
    model: Model, recordings: Sequence[Recording], criterion: Criterion = Criterion()
) -> Recordings:
    """Return recordings in the unit of torque of a model, with decided conventions of controllers.

    Conventions of a controller come before the model's. Currents are converted by the model's torque constant,
    else by known loads.

    Raises:
        IdentificationError: if the torque constant is unknown.
        ModelError: if the recordings cannot be converted to the unit of the model.
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
        recordings = [scale_swing(recording, inertia["inertia"], unit) for recording in recordings]
    unit, known, constant = find_torque_unit(recordings), model.torque_constant, None
    if unit != model.torque_unit:
        if model.torque_unit != NEWTON_METRE:
            raise ModelError(f"the model is per {model.torque_unit}, and the recordings are in {unit}: read them alike")
        if known is not None and known.unit == f"{NEWTON_METRE}/{unit}":
            constant = TorqueConstant(known.value, known.std, unit)
        recordings, _, doubt = calibrate(recordings, (), constant, inertia, criterion)
        if doubt is not None:
            raise IdentificationError(
                f"the model is in {NEWTON_METRE}, and the recordings are in {unit} with an unknown torque constant: "
                "record under known loads that differ, or identify the model with a torque constant"
            )
    if "gravity" in model.estimates and model.estimates["gravity"].value != 0:
        recordings = [set_integrated_zero(recording) for recording in recordings]
    return find_preparation(recordings).complete(recordings, model.log_format, criterion)
