"""Fits and search of a pendulum by torque, with refits by the likelihood of the motion."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fits import fit_within_laws
from estimators.data.regression_data import RegressionData
from estimators.data.standard_errors import find_stiff_stops
from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Step
from estimators.diagnosis.case import Trial
from estimators.diagnosis.unexplained import check_torque_sign, find_unexplained
from estimators.findings import Finding, collect_withheld, withhold_everything
from estimators.schemes.identifiability import ClearRows, find_undetermined, find_unidentifiable
from estimators.selection.candidates import refit_nonlinear
from estimators.selection.evidence import Evidence
from estimators.selection.refits import refit_by_likelihood, refit_if_misfit
from estimators.selection.search import SearchResult, search
from estimators.signals.measurements import measure_segments
from estimators.signals.residual import Region
from pendulum_env.physics import BASE, Term


def fit(
    train: RegressionData, holdout: RegressionData, terms: Sequence[Term] = BASE, criterion: Criterion = Criterion()
) -> Step:
    """Fit terms to windows of torque, then by likelihood as `diagnose` does; return the step with its errors."""
    is_free = all(recording.known_inertia for recording in train.recordings)  # then the terms have the known values
    evidence = Evidence.from_data(train, holdout, base=tuple(terms) if is_free else BASE, criterion=criterion)
    step = evidence.fits.fit_with_std(refit_nonlinear(evidence, tuple(terms)))
    return refit_by_likelihood(SearchResult(evidence, [step])).steps[-1]


def search_by_torque(evidence: Evidence) -> SearchResult:
    """Search for effects; with a reversed sign of torque, or without a determined parameter, fit the base only."""
    if check_torque_sign(evidence) is None and not withhold_everything(
        _find_doubts(evidence.train, evidence.fits.base)
    ):
        return refit_if_misfit(search(evidence))
    evidence = replace(evidence, library={}, tables=())
    model = fit_within_laws(evidence.train, refit_nonlinear(evidence, evidence.fits.base))
    return SearchResult(evidence, [evidence.fits.make_step(model)])


def _find_doubts(train: RegressionData, terms: Sequence[Term]) -> tuple[Finding, ...]:
    """Find the parameters that fitted rows do not determine."""
    recordings = dict.fromkeys(train.recordings)
    measured = [m for recording in recordings for m in measure_segments(recording)]
    equations, x = train.equations(terms), train.samples
    torque = train.data.torque.applied + np.asarray(x.load.torque)
    rows = ClearRows(np.asarray(x.velocity), torque, equations.phi)
    return find_undetermined(measured, terms, train.units(), rows)


def refine(trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
    """Return the result refitted by likelihood, without undetermined parameters, and findings on these.

    The result is unchanged if the sign of the logged torque is reversed.
    """
    if check_torque_sign(trial.evidence) is not None:
        return trial.result, ()
    trial.options.progress("refitting", 0.93)
    result = refit_by_likelihood(trial.result)
    *others, last = result.steps
    measured = [m for recording in trial.data.recordings for m in measure_segments(recording)]
    doubts = _find_doubts(trial.evidence.train, last.model.terms)
    unknown = find_unidentifiable(last.model, measured, doubts)
    unknown = (*unknown, *find_stiff_stops(last.model, trial.data.recordings))
    withholding = (*unknown, *(doubt for doubt in doubts if doubt.is_total))
    model = last.model.mark_unknown(collect_withheld(withholding))
    return replace(result, steps=[*others, replace(last, model=model)]), (*doubts, *unknown)


def find_unexplained_regions(trial: Trial) -> list[Region]:
    """Return the regions of the unexplained residual; none if the recordings determine no parameter."""
    is_undetermined = withhold_everything(trial.doubts) or trial.model.is_undetermined
    return [] if is_undetermined else find_unexplained(trial.final)
