"""Comparison of a model with recordings, without a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.arguments import (
    ModelSource,
    Recordings,
    check_horizon,
    check_model,
    check_options,
    select_recordings,
    select_visible_effects,
)
from estimators.checks.homogeneity import fit_each_recording
from estimators.data.calibration import convert_to_model_unit
from estimators.data.fit_data import FitData
from estimators.data.fits import compute_inertia
from estimators.data.model_errors import compute_errors
from estimators.data.preparation import find_preparation
from estimators.data.regions import compute_profiles_at, find_failures
from estimators.data.regression_data import RegressionData, drop_unstable_segments
from estimators.data.settings import DATA
from estimators.data.shared_clock import share_clock
from estimators.data.split import CutSettings
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Errors, join_errors
from estimators.diagnosis.case import DividedCase
from estimators.diagnosis.cases import choose_case, find_division
from estimators.diagnosis.checks import Subject, examine
from estimators.results import Comparison, RecordingErrors
from estimators.signals.differentiation import estimate_encoder_noise
from estimators.simulation.free_running import HORIZON
from estimators.simulation.whole_motion import WholeMotion
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.physics import Model, Samples, has_link
from pendulum_env.physics.mechanism import LinkedMechanism
from pendulum_env.recording import Recording


def compute_recording_errors(name: str, data: RegressionData, model: Model, motion: WholeMotion) -> RecordingErrors:
    """Compute the errors of a model with inertia on data, with those of its motion in the loop."""
    steady, unstable = drop_unstable_segments(data, model)
    return RecordingErrors(name, motion.extend(compute_errors(steady, model)), data.floors, unstable)


@refuse_unknown_arguments
def compare(
    model: ModelSource,
    recordings: Recordings,
    *,
    horizon: float | None = None,
    criterion: Criterion = Criterion(),
) -> Comparison:
    """Compare a model with recordings without a fit: torque residual and free-running simulation.

    A logged current is converted by the torque constant of the model, or else of the known loads. Errors with links
    are those of the torque of each joint, for all recordings together.

    Args:
        model: a model, a result with a model, or the path of a model file.
        recordings: recordings to compare, separately and together.
        horizon: length of free-running simulations [s], each from the measured state under the recorded torque; by
            default 1 s.
        criterion: limits of the decisions on recordings and residuals.

    Raises:
        IdentificationError: if a recording or a joint moves too little, a recording is shorter than the
            horizon, or no recording has a quantity that the model needs, for example a temperature.
        ModelError: if the model has no inertia, or is of a current and the recordings are not.
        TypeError: if an argument is no model or recording.
        ValueError: if the horizon is not above zero, or is given with links.
    """
    check_options(criterion)
    model = check_model(model)
    check_horizon(horizon, model.mechanism.can_simulate)
    recordings = share_clock(select_recordings(recordings, terms=model.terms, log_format=model.log_format))
    if (division := find_division(model.terms, recordings)) is not None:
        return _compare_joints(division, model, recordings, criterion)
    recordings = convert_to_model_unit(model, recordings, criterion)
    if recordings[0].units.is_prismatic:
        model = model.convert_units(recordings[0].units)
    select_visible_effects({term.id: type(term) for term in model.terms if term.needs}, recordings)
    joints = model.terms if isinstance(model.mechanism, LinkedMechanism) else ()
    separate = [] if joints else [_prepare_recording(each, model, horizon, criterion.block) for each in recordings]
    joined = RegressionData.join(separate) if separate else RegressionData.from_arm(recordings, joints, criterion.block)
    data = FitData(recordings, recordings, terms=joints, cut=CutSettings(horizon=horizon), criterion=criterion)
    data = data.with_parts((joined, joined))
    motion = find_preparation(recordings).simulate(model, recordings)
    joint = compute_recording_errors("all", joined, model, motion)
    residual = joined.residual(model.terms, model.theta)
    is_fitted = separate and not joint.errors.is_of_motion
    fits = fit_each_recording([joined.data], model.terms, criterion) if is_fitted else []
    has_torque = any(recording.has_logged_torque for recording in recordings)
    n_regions = max(1, DATA.regions // len(joint.floors))  # of all joints together
    return Comparison(
        model,
        tuple(
            compute_recording_errors(part.names[0], part, model, motion.select_recording(k))
            for k, part in enumerate(separate)
        ),
        joint,
        tuple(compute_profiles_at(joined, residual) if separate else ()),
        tuple(find_failures(joined, residual, criterion, n_regions)) if has_torque else (),
        examine(Subject("compare", choose_case(model.terms, recordings), data, model, fits=fits)),
        recordings[0].torque_constant,
        data,
        None if joints else horizon or HORIZON,
    )


def _compare_joints(
    division: DividedCase, model: Model, recordings: Sequence[Recording], criterion: Criterion
) -> Comparison:
    """Compare the model of a machine whose joints are simulated one by one: errors of the motion in the loop alone."""
    motions, floors, none = dict[str, WholeMotion](), dict[str, float](), Errors(np.nan, np.nan)
    for at, part in division.divide(model.terms, recordings, model=model).items():
        assert part.model is not None
        every = find_preparation(part.recordings).complete(part.recordings, part.model.log_format, criterion)
        motions[at] = find_preparation(every).simulate(part.model, share_clock(every))
        floors[at] = float(np.sqrt(2 / np.pi) * np.mean([estimate_encoder_noise(one) for one in every]))
    parts = [{at: motion.select_recording(k) for at, motion in motions.items()} for k in range(len(recordings))]
    names = [*(recording.name for recording in recordings), "all"]
    *errors, joint = (
        RecordingErrors(name, join_errors({at: motion.extend(none) for at, motion in part.items()}), floors)
        for name, part in zip(names, [*parts, motions], strict=True)
    )
    data = FitData(tuple(recordings), tuple(recordings), terms=model.terms, criterion=criterion)
    return Comparison(model, tuple(errors), joint, (), (), data=data, horizon=None)


def _prepare_recording(recording: Recording, model: Model, horizon: float | None, block: float) -> RegressionData:
    """Prepare a recording with the horizon [s] of free runs, and with contacts at the stops of a model."""
    motion = Samples(recording.time, recording.position, np.zeros(len(recording)), recording.torque)
    inertia = None if has_link(model.terms) else compute_inertia(model, motion)
    data = RegressionData.from_recordings([recording], inertia=inertia, block=block)
    return (data if horizon is None else data.with_horizon(horizon)).with_contacts(model)
