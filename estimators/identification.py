"""Identification: the parameters of a model from recordings, by each of the six schemes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from estimators.arguments import (
    Recordings,
    Terms,
    apply_limits,
    check_options,
    select_recordings,
    select_terms,
)
from estimators.checks.homogeneity import fit_each_recording
from estimators.data.fit_data import FitData
from estimators.data.fits import find_inertia_of_noise
from estimators.data.regression_data import RegressionData
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Step
from estimators.diagnosis.case import DividedCase, Trial
from estimators.diagnosis.cases import choose_case, find_division
from estimators.diagnosis.checks import Subject, examine
from estimators.diagnosis.options import Options
from estimators.findings import Finding, Quantity, bias_everything
from estimators.free_swings import make_swing_terms, restore_known
from estimators.regression.least_squares import IdentificationError
from estimators.schemes.balance import Segments, adapt_to_arms, measure_segments
from estimators.schemes.fitting import Convergence, Identified, fit_schemes
from estimators.schemes.identifiability import refuse_idle_joints, withhold_estimates
from estimators.schemes.result import Identification
from estimators.schemes.six import SCHEMES, LowPass, Regressor, Scheme, select_schemes
from estimators.weak_form.preparation import prepare_windows
from pendulum_env.errors import UserError
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.physics import BASE, Bounds, Model, Term
from pendulum_env.recording import Recording
from pendulum_env.recording.study import collect_log_format


@dataclass(frozen=True)
class CoarseEncoder(Finding):
    """Encoder whose noise biases the estimates of some schemes."""


@dataclass(frozen=True)
class SlowedFilter(Finding):
    """Filters whose cutoff is lowered, as the `rate` of the samples is low."""

    rate: Quantity


@refuse_unknown_arguments
def identify(
    recordings: Recordings,
    terms: Terms = BASE,
    schemes: str | Sequence[str | Regressor] = "all",
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
    criterion: Criterion = Criterion(),
) -> Identification:
    """Fit the linear parameters of the terms to all recordings together, by each scheme.

    Parameters are those of the joint without the known loads of the recordings. With a logged current, known loads
    determine the torque constant. Otherwise parameters are per ampere, and a finding states the reason.

    With links, the model has their base parameters and those of the terms at joints. A sample in which a joint sticks
    is left out of the row of this joint alone. Joints with less noise have more weight.

    Args:
        recordings: one or more; filters restart in each, and noisier recordings have less weight.
        terms: terms of the model with nonlinear parameters set, or their ids; with links
            `robots.arms.arm_base(body)`, or `Links(body)` and terms at its joints.
        schemes: schemes or their ids; a scheme that borrows the parameters of the momentum follows its lender.
        fixed: known values by name of the parameter: `{"gravity": 2.01}`.
        bounds: limits of other parameters: `{"viscous": (0.0, None)}`, None for no limit; an estimate beyond a bound
            is set to the bound.
        criterion: limits of the decisions on recordings, timing and completeness.

    Raises:
        IdentificationError: if the recordings have too little motion, or no torque.
        ValueError: if a name is unknown, a term is at no joint of the links, or a scheme comes before its lender.
        TypeError: if an argument is not of recordings, terms or schemes.
    """
    check_options(criterion)
    terms, chosen = select_terms(terms), select_schemes(schemes)
    terms, _ = apply_limits(terms, {}, fixed, bounds)
    recordings = select_recordings(recordings, terms=terms)
    if (division := find_division(terms, recordings)) is not None:
        if chosen != SCHEMES:
            raise UserError(
                "schemes are fits of torque, and these joints are simulated by their drives: leave them out"
            )
        return _identify_joints(division, recordings, terms, criterion)
    fit_data = FitData.from_recordings(recordings, terms=terms, criterion=criterion)
    swing_terms = make_swing_terms(terms, fit_data.recordings)
    segments = measure_segments(fit_data.recordings, swing_terms)
    refuse_idle_joints(fit_data.recordings, segments, swing_terms)
    chosen, filter_findings = limit_filters(chosen, segments)
    results = fit_schemes(chosen, segments, swing_terms, fit_data.recordings)
    first_model = next(iter(results.values())).model
    has_bias = any(e.is_biased for result in results.values() for e in result.model.estimates.values())
    results = _calibrate(results, fit_data, terms, swing_terms, chosen)
    results, undetermined = withhold_estimates(results, segments, swing_terms, fit_data.recordings[0].units)
    doubts = (*filter_findings, *([CoarseEncoder()] if has_bias else []), *undetermined)
    subject = _make_subject(first_model, [*results.values()], fit_data, swing_terms)
    findings = examine(replace(subject, doubts=doubts))
    log_format, first = collect_log_format(fit_data.recordings), fit_data.recordings[0]
    models = {id: replace(result.model, log_format=log_format) for id, result in results.items()}
    if bias_everything(findings):
        models = {id: model.mark_biased() for id, model in models.items()}
    return Identification(
        {id: replace(result, model=models[id]) for id, result in results.items()},
        findings,
        tuple(recording.name for recording in recordings),
        tuple(np.cumsum([sum(len(m) * m.period for m, *_ in group) for group in segments]).tolist()),
        first.torque_unit,
        first.torque_constant,
        None if subject.rows is None or not first_model.mechanism.can_simulate else subject.rows.data,
    )


def _identify_joints(
    division: DividedCase, recordings: Sequence[Recording], terms: Sequence[Term], criterion: Criterion
) -> Identification:
    """Fit the base model of each joint of a machine whose joints are simulated one by one."""
    steps = dict[str, Step]()
    for at, part in division.divide(terms, recordings).items():
        case = choose_case(part.base, part.recordings)
        data, options = case.prepare(part.recordings, part.recordings, Options(part.base, {}, criterion))
        trial = Trial.search(case, data, options)
        steps[at] = trial.present(trial.final.steps[-1], False)
    step = division.join_steps(Model(tuple(terms)), steps).with_log_format(collect_log_format(recordings))
    errors, theta, seconds = (
        step.errors["train"],
        step.model.theta,
        sum(one.time[-1] - one.time[0] for one in recordings),
    )
    std = [step.model.estimates[column.name].std for column in step.model.columns]
    convergence = Convergence(np.array([seconds]), theta[None], np.array([std]))
    count = sum(map(len, recordings))
    sizes = tuple(errors.joints.values())
    motion = errors.motion_rms, "rad", np.nan, (count, count), sizes, ("rad",) * len(sizes)
    fit = Identified("in_loop", step.model, convergence, *motion)
    return Identification({fit.scheme: fit}, (), tuple(one.name for one in recordings), (seconds,))


def _make_subject(first: Model, results: Sequence[Identified], data: FitData, terms: Sequence[Term]) -> Subject:
    """Make the subject of the checks, without rows if too little of the motion is clear of stick.

    `first` is the model of the first scheme, in the unit of the recorded torque, with all parameters.
    """
    recordings, criterion = data.recordings, data.criterion
    case = choose_case(terms, recordings)
    if not first.mechanism.can_simulate:
        subject = Subject("identify", case, data, results[0].model, schemes=results)
        with suppress(IdentificationError):
            return replace(subject, rows=RegressionData.from_arm(recordings, terms))
        return subject
    subject = Subject("identify", case, data, first, schemes=results)
    with suppress(IdentificationError):  # windows need more motion than some schemes
        windows = prepare_windows(recordings, inertia=data.cut.inertia)
        if (inertia := find_inertia_of_noise(RegressionData(windows), terms, criterion)) is not None:
            windows = prepare_windows(recordings, inertia=inertia.value)
        fits = fit_each_recording([windows], terms, criterion)
        return replace(subject, rows=RegressionData(windows), fits=fits)
    return subject


def limit_filters(
    schemes: Sequence[Regressor], segments: Segments
) -> tuple[tuple[Regressor, ...], tuple[Finding, ...]]:
    """Limit filters above the Nyquist frequency to one radian per sample; return the schemes, and a finding if any."""
    limited = list(adapt_to_arms(schemes) if len(segments[0][0]) > 1 else schemes)
    rate = min(joints[0].rate for group in segments for joints in group)
    findings: tuple[Finding, ...] = ()
    for k, scheme in enumerate(limited):
        operator = scheme.operator if isinstance(scheme, Scheme) else None
        if isinstance(operator, LowPass) and operator.cutoff >= np.pi * rate:
            limited[k] = replace(scheme, operator=replace(operator, cutoff=rate))  # type: ignore[type-var]
            findings = (SlowedFilter(Quantity(rate, unit="Hz")),)
    return tuple(limited), findings


def _calibrate(
    results: Mapping[str, Identified],
    data: FitData,
    terms: Sequence[Term],
    swing_terms: Sequence[Term],
    schemes: Sequence[Regressor],
) -> dict[str, Identified]:
    """Convert results to the unit of the recordings, and add the standard error of the torque constant.

    With a constant, all schemes are fitted again to the torque of a constant one standard error larger. `terms` are
    those of the user, `swing_terms` the fitted terms.
    """
    recordings, constant = data.recordings, data.recordings[0].torque_constant
    if constant is None:
        converted = {id: result.convert_units(recordings[0].units) for id, result in results.items()}
        return {id: replace(own, model=restore_known(own.model, terms, recordings)) for id, own in converted.items()}
    factor = 1 + constant.std / constant.value
    changed_recordings = [replace(r, torque=factor * r.torque) if r.torque_constant else r for r in recordings]
    changed = fit_schemes(schemes, measure_segments(changed_recordings, swing_terms), swing_terms, changed_recordings)
    return {id: result.with_constant_error(constant, changed[id].model) for id, result in results.items()}
