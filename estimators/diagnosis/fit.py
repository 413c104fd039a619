"""Fit of a model with one more effect, as a diagnosis makes it."""

from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.result import Addition
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding, Kind
from estimators.regression.least_squares import IdentificationError
from estimators.selection.candidates import find_best_variant, refit_nonlinear, release_parameters
from estimators.selection.errors import Step, explain_rejection
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.physical import make_confirmation_gates
from estimators.selection.search import SearchResult
from pendulum_env.physics import Model, Term
from pendulum_env.physics.terms import is_hidden
from pendulum_env.recording.study import collect_log_format


def fit_addition(case: Case, data: FitData, setting: Setting, model: Model, kind: type[Term]) -> Addition:
    """Refit a model without and with one more effect.

    Raises:
        IdentificationError: if the motion does not show the effect.
    """
    data = case.reveal(data, tuple(setting.base), kind)
    evaluator = case.evaluator(data, setting)
    before, longer = _fit_effect(evaluator, kind)
    setting.progress("refitting", 0.9)
    (refitted,) = case.refit(SearchResult(evaluator, [before]), replace(model, terms=tuple(setting.base))).steps
    more = longer.model.terms[-1]
    start = Model.build((*refitted.model.terms, more), np.append(refitted.model.theta, np.zeros(len(more.columns))))
    found = case.refit(SearchResult(evaluator, [before, longer]), start)
    after, is_gain = found.steps[-1], evaluator.is_significant(longer.model.terms, before.model.terms)
    objection = explain_rejection(make_confirmation_gates(after, refitted, evaluator.train.motions))
    if objection is None and not is_gain and not (is_hidden(more) and evaluator.train.segments):
        objection = Finding(Kind.BY_CHANCE)  # the motion shows hidden states
    trial, log_format = Trial(case, data, setting, found), collect_log_format(data.recordings)
    refitted, after = (case.present(trial, step).with_log_format(log_format) for step in (refitted, after))
    return Addition(refitted, after, evaluator.residuals.floors, objection, data.doubt)


def release_significant(evaluator: ModelEvaluator, terms: tuple[Term, ...]) -> tuple[Term, ...]:
    """Release nonlinear parameters from their default values, one by one, while the gain is significant."""
    for looser in sorted(release_parameters(evaluator, terms), key=evaluator.screening_score):
        if evaluator.is_significant(looser, terms) and not evaluator.violations(looser):
            return release_significant(evaluator, looser)
    return terms


def _fit_effect(evaluator: ModelEvaluator, kind: type[Term]) -> tuple[Step, Step]:
    """Fit the base model, and the same with the best variant of an effect.

    Raises:
        IdentificationError: if the motion does not show the effect.
    """
    evaluator.progress("fitting without it", 0.1)
    before = evaluator.fit_with_std(None, refit_nonlinear(evaluator, evaluator.base))
    evaluator.progress(f"searching {kind.id}", 0.3)
    trial = find_best_variant(evaluator, before.model.terms, kind)
    if trial is None:
        raise IdentificationError(f"{', '.join(evaluator.train.names)}: nothing there shows {kind.id}", kind.id)
    evaluator.progress(f"fitting with {kind.id}", 0.8)
    return before, evaluator.fit_with_std(
        kind.id, refit_nonlinear(evaluator, release_significant(evaluator, trial.terms))
    )
