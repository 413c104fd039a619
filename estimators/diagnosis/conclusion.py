"""Conclusion of the diagnosis of a pendulum or an arm: findings, and the next step."""

from dataclasses import dataclass, replace

from estimators.checks.closed_loop import find_feedback
from estimators.checks.remedies import find_remedies, find_uneven_clocks
from estimators.checks.signs import find_driving_friction
from estimators.checks.torque_constant import find_gain_doubts
from estimators.diagnosis.case import Trial
from estimators.diagnosis.caveats import find_caveats
from estimators.diagnosis.contacts import find_arm_contacts, find_contacts, mark_met_stops
from estimators.diagnosis.experiment import suggest_experiment
from estimators.diagnosis.questions import find_detectable_effects, list_questions
from estimators.diagnosis.ranking import Tie
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.treatments import CarriedPayload
from estimators.diagnosis.unexplained import (
    HeldOutResidual,
    check_torque_sign,
    find_holdout_structure,
    find_joint_residuals,
    find_noise_not_logged,
)
from estimators.findings import Finding, withhold_everything
from estimators.selection.physical import find_violations
from estimators.selection.tables import find_explaining_law
from pendulum_env.arms.joints import Rotor
from pendulum_env.physics import TABLES


@dataclass(frozen=True)
class NoKnownEffect(Finding):
    """Residual that no effect of the library explains.

    Attributes:
        tables: ids of tables that explain it.
        has_drive: whether the settings of a drive may be wrong.
    """

    tables: tuple[str, ...] = ()
    has_drive: bool = False


@dataclass(frozen=True)
class UnknownInertia(Finding):
    """Unknown inertia, without which no experiment can be predicted."""


@dataclass(frozen=True)
class MissingRotors(Finding):
    """Joints whose motor inertia the robot file lacks."""

    joints: tuple[str, ...]


def conclude(trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis of a pendulum with findings, detectable sizes, tables, and the next experiment.

    With a reversed sign of the logged torque, only findings on data and torque channel are added.
    """
    diagnosis = replace(diagnosis, disagreements=trial.outliers)
    channel = find_in_channel(trial, diagnosis)
    remedies = find_remedies(
        trial.release_bounds(diagnosis.model),
        trial.data.recordings,
        diagnosis.ambiguous,
        not diagnosis.unexplained,
        trial.setting.criterion,
    )
    if (cause := check_torque_sign(trial.evidence)) is not None:
        return replace(diagnosis, findings=(*remedies, *channel), no_experiment=cause)
    evidence, model, regions, doubts = trial.final.evidence, trial.model, diagnosis.unexplained, trial.doubts
    table = trial.result.table.id if trial.result.table is not None and trial.result.table.id in TABLES else None
    if regions and table is None:
        table = find_explaining_law(evidence, model.terms, TABLES.values())
    table_finding = None if table is None else NoKnownEffect((table,))
    trial.setting.progress("looking for the next experiment", 0.95)
    is_complete = not regions and len(trial.terms) == len(evidence.fits.base)
    detectable = find_detectable_effects(evidence, trial.terms, evidence.library) if is_complete else ()
    questions = list_questions(evidence, model.terms, diagnosis.ambiguous, diagnosis.candidates, doubts, detectable)
    if find_violations(model, evidence.train.motions) or not model.has_known_inertia:
        questions = []  # motion cannot be predicted
    limits = trial.setting.limits.with_default_torque((trial.data.whole or trial.data).recordings)
    suggestion, unanswerable, no_experiment = suggest_experiment(evidence, model, questions, limits, regions)
    if not model.has_known_inertia:
        no_experiment = UnknownInertia()
    elif regions and not questions:
        no_experiment = find_holdout_structure(evidence, trial.terms) or table_finding or NoKnownEffect()
    contacts = find_contacts(evidence, trial.terms, model)
    return replace(
        diagnosis,
        candidates=mark_met_stops(diagnosis.candidates, contacts),
        findings=(
            *remedies,
            *channel,
            *contacts,
            *map(Tie, diagnosis.ambiguous),
            *doubts,
            *(find_noise_not_logged(trial.final) if not (regions or withhold_everything(doubts)) else ()),
            *find_caveats(evidence, diagnosis.steps, trial.terms, detectable),
            *([table_finding] if table_finding and table_finding != no_experiment else []),
        ),
        detectable=detectable,
        suggestion=suggestion,
        no_experiment=no_experiment,
        tables=() if table is None else (table,),
        inseparable=tuple((aim.instead, aim.effect) for aim in unanswerable if aim.instead),
    )


def conclude_arm(trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
    """Return the diagnosis of an arm with the residual of each joint, tables that explain it, and the next step."""
    evidence, terms = trial.evidence, trial.terms
    residuals, regions = find_joint_residuals(evidence, terms)
    joints = [region.at for region in regions if not region.held_out_recordings]
    tables_at_joints = ([table for table in evidence.tables if table.at == joint] for joint in joints)
    tables = tuple(id for kinds in tables_at_joints if (id := find_explaining_law(evidence, terms, kinds)) is not None)
    no_experiment: Finding | None = NoKnownEffect() if residuals else None
    if residuals and not joints:
        no_experiment = HeldOutResidual(evidence.holdout.names)
    elif diagnosis.ambiguous:
        no_experiment = Tie(diagnosis.ambiguous[0])
    elif tables:
        no_experiment = NoKnownEffect(tables)
    payloads = (treatment for treatment in trial.data.treatments if isinstance(treatment, CarriedPayload))
    explained = {*residuals, *(term.at for term in terms if term.has_impacts)}
    contacts = find_arm_contacts(
        evidence, diagnosis.model, [joint for joint in diagnosis.model.body.joints if joint not in explained]
    )
    rotors = tuple(term.at for term in terms if isinstance(term, Rotor) and term.id in diagnosis.selected)
    findings = (
        *payloads,
        *contacts,
        *([MissingRotors(rotors)] if rotors else []),
        *find_driving_friction(trial.release_bounds(diagnosis.model)),
        *trial.data.timing.corrections,
    )
    candidates = mark_met_stops(diagnosis.candidates, contacts)
    return replace(
        diagnosis,
        candidates=candidates,
        findings=findings,
        no_experiment=no_experiment,
        tables=tables,
        joint_residuals=residuals,
    )


def find_in_channel(trial: Trial, diagnosis: Diagnosis) -> list[Finding]:
    """Return findings on the torque constant, the time between torque and motion, and feedback.

    Torque that acts late is reported with a dead time or lag in the model, or with an unexplained residual if the
    selected effects do not explain the delay.
    """
    data = trial.data.whole or trial.data
    constant, findings = data.recordings[0].torque_constant, [] if data.doubt is None else [data.doubt]
    if constant is not None:
        findings += find_gain_doubts(diagnosis.model, constant, data.parts[0].data, data.criterion)
    findings += data.timing.corrections
    library, found = trial.setting.library, {id for group in diagnosis.effects for id in group}
    if any(library[id]().delays_torque for id in found & library.keys()):
        findings += data.timing.find(is_late=False)
    elif diagnosis.unexplained and data.timing.find(is_late=False):
        findings += data.with_timing(
            [term for term in diagnosis.model.terms if term.id in diagnosis.selected]
        ).timing.find(is_late=False)
    findings += find_uneven_clocks(data.recordings) if diagnosis.unexplained else []
    return [*findings, *find_feedback(data.recordings, data.criterion)]
