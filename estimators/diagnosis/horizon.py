"""Refit of the final model of a pendulum to free-running motion over a long horizon.

A small error of the mean torque adds up over seconds of free motion. The refit minimises the product of two errors,
that of the free motion E_q and that of the torque E_tau: the likelihood of both with unknown noise, at equal weights.
The torque determines the inertia, on which motion over seconds depends little.

Each segment starts from its measured position and its smoothed velocity, which are not fitted, since that would hide a
drift. The horizon grows by factors of two from the default of segments, so that each fit starts where its errors are
nearly linear.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.data.model_errors import compute_errors
from estimators.data.regression_data import RegressionData, drop_unstable_segments
from estimators.decisions.decision import Decision
from estimators.decisions.errors import Step
from estimators.diagnosis.case import Trial
from estimators.diagnosis.result import HorizonRefit
from estimators.regression.least_squares import compute_robust_covariance
from estimators.selection.motion_score import exceeds_noise
from estimators.selection.physical import find_violations
from estimators.selection.policies import REFIT_TO_MOTION
from estimators.simulation import output_error
from estimators.simulation.free_running import HORIZON
from estimators.simulation.output_error import ErrorsOf
from estimators.weak_form.point import Point
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model

PROGRESS = (0.93, 0.95)  # shares of the diagnosis at begin and end of the refit
N_REWEIGHTED = 3  # fits to the last horizon, each weighted by the errors of the fit before


def refit_to_horizon(trial: Trial) -> HorizonRefit | None:
    """Refit the final model to free-running motion; None without a horizon, or if the inertia is unknown.

    A model with a motion error within the noise is not refitted. The refit is kept under the policy `REFIT_TO_MOTION`
    with the held-out position error over the horizon, and if it violates no physical bound. A keyboard interrupt ends
    it at the reached parameters.
    """
    seconds, last = trial.options.horizon, trial.final.steps[-1]
    if seconds is None or not last.model.has_known_inertia:
        return None
    data = [_select_steady(part, last.model) for part in trial.data.with_horizon(seconds).parts]
    before = _make_step(last, last.model, data)
    if not exceeds_noise(data[0].segments, before.model, trial.evidence.criterion):
        return HorizonRefit(seconds, before)
    doubled = [HORIZON * 2**k for k in range(max(0, int(np.ceil(np.log2(seconds / HORIZON)))))]
    horizons = [*doubled, *[seconds] * N_REWEIGHTED]
    point, is_interrupted, (low, high) = Point.from_model(last.model), False, PROGRESS
    try:
        for number, length in enumerate(horizons):
            share = low + (high - low) * number / len(horizons)
            trial.options.progress(f"refitting to {length:g} s of motion", share)
            point = output_error.minimise(_make_rows(data[0], length, last.model, point)[0], point)
    except KeyboardInterrupt:
        is_interrupted = True
    errors_of, clusters = _make_rows(data[0], seconds, last.model, point)
    error, slopes = output_error.compute_slopes(errors_of, point)
    model = output_error.make_model_with_covariance(
        point, compute_robust_covariance(slopes, error, clusters)
    ).convert_units(data[0].recordings[0].units)
    model = model.mark_unknown({name for name, estimate in last.model.estimates.items() if estimate.is_unknown})
    after = _make_step(last, model, data)
    decision = trial.evidence.decide(after, before, REFIT_TO_MOTION)
    train = trial.evidence.train
    decision = decision.join(Decision(tuple(find_violations(model, train.motions, train.recorded_motions))))
    return HorizonRefit(seconds, before, after, decision, is_interrupted)


def _make_step(last: Step, model: Model, data: Sequence[RegressionData]) -> Step:
    """Return a step with a model and its errors on fitted and held-out data."""
    errors = {name: compute_errors(part, model) for name, part in zip(("train", "holdout"), data, strict=True)}
    return Step(last.added, model, errors)


def _select_steady(part: RegressionData, model: Model) -> RegressionData:
    """Return the data with link states of a model, and without segments in which a small error grows tenfold."""
    return drop_unstable_segments(part.with_link_states(model), model)[0]


def _make_rows(data: RegressionData, seconds: float, model: Model, point: Point) -> tuple[ErrorsOf, Index]:
    """Return a function of K points that gives errors (R, K) of free motion and torque, and their clusters (R,).

    Motion and torque have norm one at `point`. Segments last `seconds`; those in which small errors grow are left out,
    and those with a large error have a small weight.
    """
    segments = _select_steady(data.with_horizon(seconds, covers=True), model).segments
    weights = np.sqrt(data.equations(point.terms).weights)
    error, owner = output_error.compute_errors(segments, [point], from_measured=True)
    trust = np.sqrt(output_error.weigh_segments(output_error.compute_rms_by_segment(error, owner)))[owner]

    def compute_parts(points: Sequence[Point]) -> tuple[Array, Array]:
        motion = output_error.compute_errors(segments, points, from_measured=True)[0]
        torque = np.column_stack([data.residual(point_k.terms, point_k.theta) for point_k in points])
        return motion * trust[:, None], torque * weights[:, None]

    scales = [1 / np.linalg.norm(part) for part in compute_parts([point])]
    clusters = np.concatenate([owner, owner.max() + 1 + data.layout.clusters])
    return lambda points: np.vstack([s * part for s, part in zip(scales, compute_parts(points), strict=True)]), clusters
