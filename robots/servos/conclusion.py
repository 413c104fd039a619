"""Conclusion of the diagnosis of servos: findings on the drive and the goals, and the residual of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.data.regions import ResidualWithoutPlace
from estimators.decisions.criterion import LoopLimits
from estimators.diagnosis.case import Trial
from estimators.diagnosis.result import Diagnosis
from estimators.findings import Finding, Quantity
from estimators.signals.residual import Region, make_region_everywhere
from pendulum_env.physics import Model, list_ids
from pendulum_env.recording import Recording
from robots.servos.refit import make_data, refine_rows
from robots.servos.torque import compute_commanded_torque, list_drives


@dataclass(frozen=True)
class ResultOfLongSteps(Finding):
    """Effect that integration with shorter steps does not need."""


@dataclass(frozen=True)
class DoubtfulDrive(Finding):
    """Description of a drive that may be wrong: no effect explains the residual."""


@dataclass(frozen=True)
class UnknownSpeedRate(Finding):
    """Unknown rate of the speed of a drive; at some `rate` its gain imitates an `inertia`."""

    rate: Quantity
    inertia: Quantity


@dataclass(frozen=True)
class ScaledTorque(Finding):
    """Logged torque that is the torque requested by the drive, times a factor."""

    factor: float


def conclude(trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
    """Add the next step.

    Candidates that the refit dropped get the reason `ResultOfLongSteps`. An unexplained residual forbids a next
    experiment.
    """
    dropped = list_ids(trial.result.terms) - list_ids(trial.final.terms)
    return replace(
        diagnosis,
        candidates=tuple(
            replace(candidate, reason=ResultOfLongSteps()) if candidate.effect in dropped else candidate
            for candidate in diagnosis.candidates
        ),
        no_experiment=DoubtfulDrive() if diagnosis.unexplained else None,
    )


def find_speed_rate(model: Model, recordings: Sequence[Recording], limits: LoopLimits) -> UnknownSpeedRate | None:
    """Return a finding if a controller of unknown rate may act so late that its gain imitates inertia.

    The imitated inertia is half the speed gain over `slow_rate` [Hz]; it counts above one standard error.
    """
    drives = [drive for drive in list_drives(recordings) if drive.rate is None]
    gains = [(drive.kp if drive.acts_on_speed else drive.kd) * (drive.gain or 1.0) for drive in drives]
    imitated_inertia = max(gains, default=0.0) / (2 * limits.slow_rate)
    if imitated_inertia <= model.estimates["inertia"].std:
        return None
    inertia = Quantity(imitated_inertia, unit=model.estimates["inertia"].unit)
    return UnknownSpeedRate(Quantity(limits.slow_rate, unit="Hz"), inertia)


def find_torque_scale(recordings: Sequence[Recording], limits: LoopLimits) -> ScaledTorque | None:
    """Return a finding if the logged torque is that requested by the drive times a factor off 1.

    The factor is off by at least `torque_scale`. Drives with an integral part are not tested: the requested
    torque is that without it.
    """
    logs = [r for r in recordings if any(not drive.ki and r.torque_unit == drive.unit for drive in list_drives([r]))]
    recorded = [r for r in logs if r.has_logged_torque]
    if not recorded:
        return None
    logged, requested = (
        np.concatenate(series)
        for series in zip(*((r.torque, compute_commanded_torque(r)) for r in recorded), strict=True)
    )
    factor = float(logged @ requested / max(requested @ requested, np.finfo(float).tiny))
    if abs(factor - 1.0) < limits.torque_scale:
        return None
    return ScaledTorque(factor)


def find_loop_regions(trial: Trial) -> Sequence[Region]:
    """Find the residual of the motion under the final model: one region, with the recording of the largest error.

    The result is empty if the residual is noise in fitted and in held-out data.
    """
    evidence, last, theta = trial.evidence, trial.final.steps[-1], np.asarray(trial.final.steps[-1].model.theta)
    for rows, names in zip(refine_rows(evidence), ((), evidence.holdout.names), strict=True):
        residual, data, part = rows.residual(last.model.terms, theta), rows.rollouts, make_data(rows)
        if evidence.residuals.is_noise_in(part, residual):
            continue
        mean_errors = np.array(
            [np.mean(np.abs(residual[data.positions.recording_of == k])) for k in range(len(data.recordings))]
        )
        worst = int(np.argmax(mean_errors))
        error, floor = float(np.mean(np.abs(residual))), data.noise.encoder_error
        unit = last.model.units().unit("rad")
        largest = Quantity(mean_errors[worst], unit=unit) if len(mean_errors) > 1 else None
        span = float(np.ptp(data.positions.measured))
        share = error / span if span > error else None  # of a joint that moves
        worst_name = data.recordings[worst].name
        cause = ResidualWithoutPlace(Quantity(error, unit=unit), error / floor, largest, worst_name, share)
        return [replace(make_region_everywhere(cause, part.samples, error, floor), held_out_recordings=names)]
    return []
