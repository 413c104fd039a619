"""Explanation of a search: verdicts on effects, the unexplained residual, and the next step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimators.data.treatment import Action, Treatment
from estimators.diagnosis.case import Trial
from estimators.diagnosis.ranking import rank_effects
from estimators.diagnosis.result import Diagnosis, TriedTreatment
from estimators.findings import Finding
from pendulum_env.recording.study import collect_log_format


def explain(trial: Trial, treatments: Sequence[TriedTreatment]) -> Diagnosis:
    """Return the diagnosis of a trial: verdicts, refit to the horizon, residual, findings and the next step."""
    trial.setting.progress("judging", 0.93)
    has_contacts = Treatment(Action.IMPACTS_INCLUDED) in [tried.treatment for tried in treatments]
    candidates, groups = rank_effects(trial.final, trial.terms, trial.doubts, has_contacts)
    refit = trial.case.refit_to_horizon(trial) if trial.case.refit_to_horizon is not None else None
    *others, last = trial.final.steps
    if refit is not None:
        refitted = refit.after
        if refitted is not None:
            last = trial.evidence.fits.make_step(refitted.model, added=last.added) if refit.is_kept else last
            refitted = trial.present(refitted, True)
        refit = replace(refit, before=trial.present(refit.before, True), after=refitted)
    steps = [trial.present(step, step is last) for step in (*others, last)]
    data = trial.data.with_horizon(trial.setting.horizon)
    diagnosis = Diagnosis(
        steps=(*steps[:-1], steps[-1].with_log_format(collect_log_format(data.recordings))),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=trial.unexplained,
        floors=trial.evidence.residuals.holdout_floors,
        findings=(),
        alignments=(data.whole or data).timing.alignments,
        torque_constant=data.recordings[0].torque_constant,
        data=data.without_history(last.model.terms),
        evidence=trial.evidence,
        treatments=tuple(treatments),
        refit=refit,
    )
    diagnosis = trial.case.conclude(trial, diagnosis)
    diagnosis = replace(diagnosis, findings=(*diagnosis.findings, *find_small_effect(diagnosis)))
    trial.setting.progress("done", 1.0)
    return diagnosis


@dataclass(frozen=True)
class SmallEffect(Finding):
    """Effect that predicts better, with a p-value, but explains a smaller share than the `least`."""

    effect: str
    share: float
    least: float
    p_value: float


def find_small_effect(diagnosis: Diagnosis) -> list[SmallEffect]:
    """Return a finding on the effect with the largest gain that failed only by its explained share.

    The list is empty if effects were selected or a residual is unexplained.
    """
    if diagnosis.selected or diagnosis.unexplained:
        return []
    pairs = [(candidate, {gate.name: gate for gate in candidate.decision.gates}) for candidate in diagnosis.candidates]
    small = [(c, gates) for c, gates in pairs if [*gates][-1:] == ["explained_share"] and "p_value" in gates]
    if not small:
        return []
    candidate, gates = max(small, key=lambda pair: pair[1]["gain"].value)
    share = gates["explained_share"]
    return [SmallEffect(candidate.effect, share.value, share.limit, gates["p_value"].value)]
