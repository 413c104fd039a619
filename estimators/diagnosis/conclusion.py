"""Conclusion of the diagnosis of a pendulum: the next step."""

from dataclasses import dataclass, replace

from estimators.diagnosis.case import Trial
from estimators.diagnosis.experiment import UnreachableAims, suggest_experiment
from estimators.diagnosis.questions import find_detectable_effects, list_questions
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.unexplained import check_torque_sign, find_holdout_structure
from estimators.findings import Finding
from estimators.selection.tables import find_explaining_law
from pendulum_env.physics import TABLES, list_ids


@dataclass(frozen=True)
class NoKnownEffect(Finding):
    """Residual that no effect of the library explains; `tables` are the ids of tables that explain it."""

    tables: tuple[str, ...] = ()


@dataclass(frozen=True)
class UnknownInertia(Finding):
    """Unknown inertia, without which no experiment can be predicted."""


def conclude(trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis of a pendulum with detectable sizes, tables, and the next experiment.

    With a reversed sign of the logged torque there is none of these.
    """
    if (cause := check_torque_sign(trial.evidence)) is not None:
        return replace(diagnosis, no_experiment=cause)
    evidence, model, regions, doubts = trial.final.evidence, trial.model, diagnosis.unexplained, trial.doubts
    table = trial.result.table.id if trial.result.table is not None and trial.result.table.id in TABLES else None
    if regions and table is None:
        table = find_explaining_law(evidence, model.terms, TABLES.values())
    trial.options.progress("looking for the next experiment", 0.95)
    absent = {id: kind for id, kind in evidence.library.items() if id not in list_ids(trial.terms)}
    detectable = () if regions else find_detectable_effects(evidence, trial.terms, absent)
    asked = detectable if len(trial.terms) == len(evidence.fits.base) else ()  # none beside found effects
    questions = list_questions(evidence, model.terms, diagnosis.ambiguous, diagnosis.candidates, doubts, asked)
    if not model.has_known_inertia:
        questions = []  # motion cannot be predicted
    limits = trial.options.limits.with_default_torque((trial.data.whole or trial.data).recordings)
    suggestion, unanswerable, no_experiment = suggest_experiment(evidence, model, questions, limits, regions)
    tables = () if table is None else (table,)
    if not model.has_known_inertia:
        no_experiment = UnknownInertia()
    elif regions and not questions:
        no_experiment = find_holdout_structure(evidence, trial.terms) or NoKnownEffect(tables)
    inseparable = tuple(aim for aim in unanswerable if aim.instead)
    findings = (UnreachableAims(inseparable),) if inseparable else ()
    if suggestion is None and no_experiment is None and findings:
        (no_experiment,), findings = findings, ()
    return replace(
        diagnosis,
        findings=findings,
        detectable=detectable,
        suggestion=suggestion,
        no_experiment=no_experiment,
        tables=tables,
    )
