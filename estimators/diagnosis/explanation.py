"""Explanation of a search: verdicts on effects, the unexplained residual, and the next step."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.data.treatment import Action
from estimators.diagnosis.case import Trial
from estimators.diagnosis.checks import Subject, examine
from estimators.diagnosis.contacts import mark_met_stops
from estimators.diagnosis.ranking import rank_effects, widen_by_rivals
from estimators.diagnosis.result import Diagnosis, TriedTreatment
from pendulum_env.recording.study import collect_log_format


def explain(trial: Trial, treatments: Sequence[TriedTreatment]) -> Diagnosis:
    """Return the diagnosis of a trial: verdicts, refit to the horizon, residual, findings and the next step."""
    trial.options.progress("judging", 0.93)
    has_contacts = any(tried.action == Action.IMPACTS_INCLUDED for tried in treatments)
    candidates, groups = rank_effects(trial.final, trial.terms, trial.doubts, has_contacts)
    refit = trial.case.refit_to_horizon(trial)
    *others, last = trial.final.steps
    if refit is not None:
        refitted = refit.after
        if refitted is not None:
            last = trial.evidence.fits.make_step(refitted.model, added=last.added) if refit.is_kept else last
            refitted = trial.present(refitted, True)
        refit = replace(refit, before=trial.present(refit.before, True), after=refitted)
    last = replace(last, model=widen_by_rivals(last.model, trial.evidence, candidates))
    steps = [*(trial.present(step, False) for step in others), trial.present(last, True)]
    data = trial.data.with_horizon(trial.options.horizon)
    diagnosis = Diagnosis(
        steps=(*steps[:-1], steps[-1].with_log_format(collect_log_format(data.recordings))),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=trial.unexplained,
        floors=trial.case.find_floors(trial),
        findings=(),
        alignments=(data.whole or data).timing.alignments,
        torque_constant=data.recordings[0].torque_constant,
        data=data.without_history(last.model.terms),
        evidence=trial.evidence,
        treatments=tuple(treatments),
        refit=refit,
    )
    diagnosis = trial.case.conclude(trial, diagnosis)
    findings = (*examine(Subject.from_trial(trial, diagnosis)), *diagnosis.findings)
    diagnosis = replace(diagnosis, findings=findings, candidates=mark_met_stops(diagnosis.candidates, findings))
    trial.options.progress("done", 1.0)
    return diagnosis
