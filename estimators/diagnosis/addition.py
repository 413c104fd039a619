"""Addition of one chosen effect to a model: by torque and free runs, or by motion with a controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimators.arguments import (
    ModelSource,
    Recordings,
    apply_limits,
    check_model,
    check_options,
    select_parts,
    select_visible_effects,
)
from estimators.data.fit_data import FitData
from estimators.data.preparation import find_preparation
from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import Decision
from estimators.decisions.errors import Step
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.cases import choose_case, find_division
from estimators.diagnosis.checks import Subject, examine
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Addition
from estimators.diagnosis.treatments import decide_treatment, scale_noise_by_model
from estimators.free_swings import find_scaling_values
from estimators.progress import Progress, no_progress
from estimators.regression.least_squares import IdentificationError
from estimators.selection.candidates import (
    find_best_variant,
    find_undetermined_parameter,
    refit_nonlinear,
    release_significant,
)
from estimators.selection.evidence import Evidence
from estimators.selection.moves import add_dry_friction
from estimators.selection.path import find_model_path
from estimators.selection.policies import BEAT_CHANCE, CONFIRM, SWAP
from estimators.selection.search import SearchResult
from estimators.selection.state import SearchState
from pendulum_env.lookup import find, refuse_unknown_arguments
from pendulum_env.physics import Bounds, Model, Term, is_dry, is_hidden, list_nameable
from pendulum_env.physics.effect_texts import name_effect
from pendulum_env.physics.joints import find_kind
from pendulum_env.recording import Recording
from pendulum_env.recording.study import collect_log_format


@refuse_unknown_arguments
def add(
    model: ModelSource,
    id: str,
    recordings: Recordings,
    holdout: Recordings = (),
    progress: Progress = no_progress,
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Bounds | None = None,
    criterion: Criterion = Criterion(),
) -> Addition:
    """Refit a model's terms, then with one more effect.

    Args:
        model: to start from: a model, a result with a model, or the path of a model file.
        id: of the effect or table (`torque_by_angle`); with links at a joint, `stribeck@elbow`.
        recordings: fitted jointly.
        holdout: confirm the effect; by default the last 30 % of each recording.
        progress: called with the present work and the share that is done.
        fixed: known values by name of the parameter: `{"gravity": 2.01}`.
        bounds: of other parameters: `{"stribeck": (0.0, 0.5)}`; None is no limit.
        criterion: thresholds of the decisions.

    Raises:
        ValueError: if the effect, its joint or a parameter is unknown.
        ModelError: if the model has the effect already, or has no inertia.
        IdentificationError: if the recordings hold too little motion, or do not show the effect.
        TypeError: if an argument is no model, id or recordings.
    """
    check_options(criterion, progress)
    if not isinstance(id, str):
        raise TypeError(f"an effect is added by its id, such as 'stribeck', got {id!r}")
    model = check_model(model)
    mechanism = model.mechanism
    recordings, holdout = select_parts(recordings, holdout, model.terms, model.log_format)
    every, count = (*recordings, *holdout), len(recordings)
    every = find_preparation(every).declare(every, model.log_format)
    recordings, holdout = every[:count], every[count:]
    model.refuse_present(id)
    kind = find_kind(id, mechanism)
    model.add(kind())  # raises if a term of the model contains it
    select_visible_effects({kind.id: kind}, recordings)  # raises if it needs a quantity that no recording has
    if (division := find_division(model.terms, every)) is not None:
        name = kind.id.partition("@")[0]
        find("effect of a servo", name, list_nameable())
        part = division.divide(model.terms, recordings, holdout, {kind.id: kind}, model)[kind.at]
        assert part.model is not None
        own = part.library[name]
        addition = _add_kind(part.model, own, part.recordings, part.holdout, progress, fixed, bounds, criterion)
        steps = (division.join_steps(model, {kind.at: step}) for step in (addition.before, addition.after))
        before, after = (step.with_log_format(dict(model.log_format)) for step in steps)
        (floor,) = addition.floors.values()  # of the one joint
        return replace(addition, before=before, after=replace(after, added=kind.id), floors={kind.at: floor})
    return _add_kind(model, kind, recordings, holdout, progress, fixed, bounds, criterion)


def _add_kind(
    model: Model,
    kind: type[Term],
    recordings: Sequence[Recording],
    holdout: Sequence[Recording],
    progress: Progress,
    fixed: Mapping[str, float] | None,
    bounds: Bounds | None,
    criterion: Criterion,
) -> Addition:
    """Refit a model's terms, then with one more effect; arguments as of `add`."""
    if all(recording.is_free for recording in recordings):
        fixed = find_scaling_values(model, fixed)
    terms, library = apply_limits(model.terms, {kind.id: kind}, fixed, bounds)
    options = Options(terms, library, criterion, progress=progress, known=model)
    case = choose_case(terms, (*recordings, *holdout))
    progress("reading the motion", 0.0)
    data, options = case.prepare(recordings, holdout, options)
    data, kind = case.show_effect(data, tuple(options.base), library[kind.id]), library[kind.id]
    trial, before, decision = _fit_effect(case, data, options, kind, model)
    if decision.passed and (scaled := scale_noise_by_model(trial)) is not None:
        scaled_fit = _fit_effect(case, scaled, options, kind, model)
        if decide_treatment(scaled_fit[0], trial).is_kept:
            trial, before, decision = scaled_fit
    log_format = collect_log_format(trial.data.recordings)
    steps = case.present(trial, before, True), trial.present(trial.final.steps[-1], True)
    before, after = (step.with_log_format(log_format) for step in steps)
    findings = examine(Subject("add", case, trial.data, after.model))
    return Addition(before, after, case.find_floors(trial), decision, findings, criterion)


def _fit_effect(
    case: Case, data: FitData, options: Options, kind: type[Term], model: Model
) -> tuple[Trial, Step, Decision]:
    """Return a trial with one more effect, the refitted step without it, and the decision on the effect.

    Refits of links start from the parameters of the model.
    """
    evidence = case.make_evidence(data, options)
    before, longer = fit_without_and_with(evidence, kind)
    options.progress("refitting", 0.9)
    (refitted,) = case.refit(SearchResult(evidence, [before]), replace(model, terms=tuple(options.base))).steps
    added = longer.model.terms[-1]
    result = case.refit(SearchResult(evidence, [before, longer]), refitted.model.add(added))
    after, is_shown = result.steps[-1], is_hidden(added) and evidence.train.segments  # the motion shows hidden states
    decision = evidence.decide(after, refitted, CONFIRM)
    if decision.passed and not is_shown:
        decision = decision.join(evidence.decide(longer.model.terms, before.model.terms, BEAT_CHANCE))
    return Trial(case, data, options, result, refit=result), refitted, decision


def fit_without_and_with(evidence: Evidence, kind: type[Term]) -> list[Step]:
    """Return the steps from the base model to that with the best variant of an effect, with standard errors.

    Dry friction that is not significant in torque is fitted to free motion, if that confirms it.

    Raises:
        IdentificationError: if the data offer no variant of the effect, or do not determine it.
    """
    evidence.progress("fitting without it", 0.1)
    start = refit_nonlinear(evidence, evidence.fits.base)
    evidence.progress(f"searching the best {name_effect(kind.id)}", 0.3)
    trial = find_best_variant(evidence, start, kind, is_determined=True)
    terms = None if trial is None else refit_nonlinear(evidence, release_significant(evidence, trial.terms))
    if is_dry(kind()) and (terms is None or not evidence.decide(terms, start, SWAP).passed):
        if (by_motion := add_dry_friction(SearchState(evidence, start, start))) is not None:
            return find_model_path(by_motion)
    if terms is None:
        raise IdentificationError(f"{', '.join(evidence.train.names)}: nothing there shows {kind.id}", kind.id)
    evidence.progress(f"fitting with {name_effect(kind.id)}", 0.8)
    before, longer = evidence.fits.fit_with_std(start), evidence.fits.fit_with_std(terms, added=kind.id)
    if (name := find_undetermined_parameter(evidence, longer)) is not None:
        raise IdentificationError(
            f"{', '.join(evidence.train.names)}: {name} is not determined: within its standard error "
            "it means more torque than was applied",
            longer.model.terms[-1].id,
        )
    return [before, longer]
