"""Explanation of a search: verdicts on effects, the unexplained residual, and the next step."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.diagnosis.case import Trial
from estimators.diagnosis.ranking import rank_effects
from estimators.diagnosis.result import Diagnosis, TriedTreatment
from pendulum_env.recording.study import format_of


def explain(trial: Trial, tried: Sequence[TriedTreatment]) -> Diagnosis:
    """Rank the effects of a trial, and add findings, the residual and the next step."""
    trial.setting.progress("judging", 0.93)
    candidates, groups = rank_effects(trial.final, trial.terms, trial.doubts)
    *others, last = (trial.case.present(trial, step) for step in trial.final.steps)
    last = replace(last, model=last.model.biased()) if trial.unexplained else last
    data = trial.data
    found = Diagnosis(
        steps=(*others, last.with_log_format(format_of(data.recordings))),
        candidates=tuple(candidates),
        ambiguous=tuple(groups),
        unexplained=trial.unexplained,
        floors=trial.evaluator.residuals.floors,
        findings=(),
        alignments=(data.whole or data).alignments,
        torque_unit=data.unit,
        torque_constant=data.constant,
        data=data.without_history(last.model.terms),
        evaluator=trial.evaluator,
        treatments=tuple(tried),
    )
    found = trial.case.conclude(trial, found)
    trial.setting.progress("done", 1.0)
    return found
