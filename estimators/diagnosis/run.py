"""Diagnosis: which physical effects does the model lack?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimators.arguments import (
    Recordings,
    Terms,
    apply_limits,
    check_horizon,
    check_options,
    select_effects,
    select_parts,
    select_terms,
    select_visible_effects,
)
from estimators.data.fit_data import FitData
from estimators.decisions.criterion import Criterion
from estimators.diagnosis.case import DividedCase
from estimators.diagnosis.cases import choose_case, find_division
from estimators.diagnosis.experiment import ExperimentLimits
from estimators.diagnosis.explanation import explain
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.treatments import choose_treatment
from estimators.progress import Progress, no_progress, report_forward
from pendulum_env.errors import UserError
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.physics import BASE, Bounds, Term
from pendulum_env.physics.joints import find_mechanism
from pendulum_env.recording import Recording


@refuse_unknown_arguments
def diagnose(
    recordings: Recordings,
    holdout: Recordings = (),
    base: Terms = BASE,
    progress: Progress = no_progress,
    *,
    max_torque: float | None = None,
    max_angle: float | None = None,
    max_speed: float | None = None,
    library: Mapping[str, type[Term]] | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
    criterion: Criterion = Criterion(),
    rng: np.random.Generator | int | None = None,
    horizon: float | None = None,
) -> Diagnosis:
    """Find the effects that the base model lacks.

    Torque that is logged late or filtered is corrected first. If the found effects change the estimated delay, the
    torque is corrected again and the search repeated. Recordings that disagree with the others are reported and not
    fitted. Known loads are not part of the model; with a logged current they determine the torque constant. Without
    known loads, parameters are per ampere.

    With links, effects are searched at the joints by torque alone, without simulation or suggested experiments.

    Args:
        recordings: fitted jointly.
        holdout: confirm effects; by default the last 30 % of each recording, or of its motion if that comes late.
        base: at least one term to start from, or its id; with links `robots.arms.arm_base(body)`, or `Links(body)`
            first.
        progress: called with the present work and the share that is done.
        max_torque: bound of the experiment's torque [N m]. The default is the largest recorded torque, or, if larger,
            the smaller of 6 N m and ten times the largest. Logs in other units use the largest recorded torque.
        max_angle: largest angle from hanging down in either direction [rad]; infinity for no bound. The default is the
            recorded range, or for a joint that makes whole turns, as many turns in either direction.
        max_speed: largest speed [rad/s]; by default the highest recorded speed.
        library: effects that may be selected, by id; by default all registered effects.
        only: ids of the searched effects; by default all. With links `stribeck`, or `stribeck@elbow` at one joint.
        without: ids of effects that are not searched.
        fixed: known values by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5), "cogging.order": (10, None)}`; None is no limit.
        criterion: thresholds of the decisions.
        rng: random numbers of the bootstrap, or their seed; by default 0.
        horizon: refit the final model to free-running motion over this time [s]; verdicts do not depend on it.

    Raises:
        IdentificationError: if the recordings hold too little motion, or are shorter than the horizon.
        ValueError: if a name is unknown, the horizon is not above zero, or the horizon or bounds of the experiment are
            given with links or for recordings with a controller.
        TypeError: if an argument is neither recordings nor terms.
    """
    check_options(criterion, progress)
    terms = select_terms(base)
    mechanism = find_mechanism(terms)
    terms, effects = apply_limits(terms, select_effects(library, only, without, mechanism), fixed, bounds)
    fitted, held_out = select_parts(recordings, holdout, terms)
    effects, limits = select_visible_effects(effects, fitted), ExperimentLimits(max_torque, max_angle, max_speed)
    rng, progress = np.random.default_rng(0 if rng is None else rng), report_forward(progress)
    options = Options(terms, effects, criterion, rng, progress, limits, horizon)
    every = (*fitted, *held_out)
    case = find_division(terms, every) or choose_case(terms, every)
    check_horizon(horizon, case.has_free_motion)
    if not case.has_free_motion and limits != ExperimentLimits():
        raise UserError("bounds of an experiment are for pendulums under a known torque: leave them out")
    if isinstance(case, DividedCase):
        return _diagnose_joints(case, fitted, held_out, options)
    progress("reading the motion", 0.0)
    data, options = case.prepare(fitted, held_out, options)
    progress("timing the torque", 0.0)
    best, tried = choose_treatment(case, data.with_timing() if case.is_timed else data, options)
    return explain(best, tried)


def _diagnose_joints(
    division: DividedCase, fitted: Sequence[Recording], holdout: Sequence[Recording], options: Options
) -> Diagnosis:
    """Diagnose the joints of a machine one by one, and join the results."""
    library, diagnoses = division.select_quick(options.library), {}
    parts = division.divide(options.base, fitted, holdout, library)
    for number, (at, part) in enumerate(parts.items()):

        def report(text: str, share: float, at: str = at, number: int = number) -> None:
            options.progress(f"{at}: {text}", (number + share) / len(parts))

        diagnosis = diagnose(
            part.recordings,
            part.holdout,
            part.base,
            report,
            library=part.library,
            criterion=options.criterion,
            rng=options.rng,
        )
        diagnoses[at] = replace(diagnosis, evidence=None)  # its simulations need much memory
        found = ", ".join(diagnoses[at].selected) or "no effect"
        options.progress(f"{at}: {found} found", (number + 1) / len(parts))
    data = FitData(tuple(fitted), tuple(holdout), terms=tuple(options.base), criterion=options.criterion)
    return division.join_diagnoses(data, diagnoses)
