"""Candidate treatments of the recordings: each gives other data, and the best is kept by one rule."""

from estimators.data.fit_data import FitData
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.result import TriedTreatment
from estimators.diagnosis.setting import Setting
from estimators.findings import Kind
from estimators.selection.evaluator import held_out_cost
from estimators.selection.motion import is_misfit
from pendulum_env.physics import BASE, Term
from pendulum_env.physics.terms import ids

WINDOWS = {Kind.NARROWER_WINDOWS, Kind.IMPACTS_INCLUDED}  # treatments of the windows alone


def best_treatment(case: Case, data: FitData, setting: Setting) -> tuple[Trial, tuple[TriedTreatment, ...]]:
    """Search for effects in the data and under each candidate treatment, and keep the best.

    Where recordings are kept or left out otherwise, the other treatments are tried again.

    Returns:
        The best trial, and all treatments that were tried.
    """
    best, tried, waiting = Trial.of(case, data, setting), list[TriedTreatment](), list(case.treatments)
    while waiting:
        treated = waiting.pop(0)(best)
        if treated is None:
            continue
        trial = Trial.of(case, treated, setting)
        tried.append(compare_treatment(trial, best))
        if tried[-1].is_kept:
            best = trial
            waiting = waiting if tried[-1].treatment.kind in WINDOWS else list(case.treatments)
    return best, tuple(tried)


def compare_treatment(trial: Trial, best: Trial) -> TriedTreatment:
    """Score a treatment by the held-out error of its model, relative to the model that was found without it.

    The error is that of torque times that of free-running motion. The density of blocks is no score here: windows of
    different width have none in common, and states that windows hide show in the motion alone. Both models are
    compared on the treated data; under another timing torque is another quantity, and each is compared on its own.
    """
    treatment = next(own for own in trial.data.treatments if own not in best.data.treatments)
    after, before = trial.found.steps[-1], best.found.steps[-1]
    if treatment.kind is not Kind.TIMED_BESIDE:
        before = trial.evaluator.make_step(None, before.model)
    ratio = held_out_cost(after) / max(held_out_cost(before), 1e-300)
    counts = n_assumptions(trial), n_assumptions(best)
    return TriedTreatment(treatment, ratio, *counts, is_better(ratio, *counts, trial.evaluator.criterion.error_margin))


def is_better(error_ratio: float, assumptions: int, before: int, margin: float) -> bool:
    """Return whether a treatment is kept: its model predicts better, or as well by no more assumptions.

    Errors that agree within the margin differ by chance. Assumptions are effects, corrected torque, and treatments of
    the windows; recordings that are left out are none, since a test of its own has found that they disagree.
    """
    return error_ratio < 1 - margin or (error_ratio < 1 + margin and assumptions <= before)


def n_assumptions(trial: Trial) -> int:
    """Return the number of effects, of timings that were corrected, and of treatments of windows."""
    windows = [treatment for treatment in trial.data.treatments if treatment.kind in WINDOWS]
    return len(trial.found.steps) - 1 + trial.data.has_moved + len(windows)


def narrow_windows(trial: Trial) -> FitData | None:
    """Narrow the windows where torque shows noise alone and motion more: they come closer to reversals."""
    evaluator, found = trial.evaluator, trial.found
    if trial.data.has_treatment(Kind.NARROWER_WINDOWS):
        return None
    if not evaluator.residuals.is_noise_by_part(found.terms)[0] or not is_misfit(evaluator, found.steps[-1]):
        return None
    return trial.data.with_narrower_windows(evaluator.criterion.shorter_window)


def include_impacts(trial: Trial) -> FitData | None:
    """Include windows at reversals that miss more torque than dry friction can be."""
    if trial.data.has_treatment(Kind.IMPACTS_INCLUDED):
        return None
    struck = trial.data.with_impacts(trial.found.terms)
    return None if struck is trial.data else struck


def exclude_outliers(trial: Trial) -> FitData | None:
    """Leave out recordings of another plant: no effect of one plant explains two."""
    kept = (trial.data.whole or trial.data).without(trial.outliers)
    return kept if len(kept.recordings) < len(trial.data.recordings) else None


def time_beside_effects(trial: Trial) -> FitData | None:
    """Time the torque beside the effects that were found: an effect may look like a delay, or hide one."""
    known = ids((*BASE, *(term for term in trial.data.terms if isinstance(term, Term))))
    beside = [term for term in trial.found.terms if term.id not in known]
    if not beside or trial.data.has_treatment(Kind.TIMED_BESIDE) or not (trial.data.has_moved or trial.unexplained):
        return None
    again = trial.data.timed(beside)
    return None if again.agrees(trial.data) else again
