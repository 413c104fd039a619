"""Checks of a result: one list, in the order of print, for `identify`, `compare`, `add` and `diagnose`.

A check is a function of a `Subject` that returns findings; it returns none where it does not apply.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from estimators.checks.alignment import TorqueTiming
from estimators.checks.closed_loop import find_feedback
from estimators.checks.homogeneity import (
    Disagreement,
    RecordingFit,
    find_disagreements,
    find_disagreements_with_model,
    find_misfits,
)
from estimators.checks.remedies import WrongColumn, find_remedies, find_uneven_clocks
from estimators.checks.signs import NegativeParameters, find_driving_friction
from estimators.checks.torque_constant import find_gain_doubts
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.case import Trial
from estimators.diagnosis.caveats import find_caveats
from estimators.diagnosis.completeness import Incomplete, find_incompleteness
from estimators.diagnosis.conclusion import MissingRotors, NoKnownEffect
from estimators.diagnosis.contacts import find_arm_contacts, find_contacts
from estimators.diagnosis.ranking import Tie
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.servo_conclusion import find_speed_rate, find_torque_scale
from estimators.diagnosis.small_effect import find_small_effect
from estimators.diagnosis.treatments import CarriedPayload
from estimators.diagnosis.unexplained import find_noise_not_logged
from estimators.findings import Finding, withhold_everything
from estimators.in_loop import list_decisions
from estimators.schemes.fitting import Identified
from pendulum_env.arms.joints import Rotor
from pendulum_env.physics import Model, Term


@dataclass(frozen=True)
class Subject:
    """Model and recordings that are checked.

    Attributes:
        data: recordings with their treatments, before recordings were excluded.
        model: the model; of a diagnosis refitted without the bounds of a body.
        doubts: findings of the fit: parameters that the recordings do not determine, and changed filters.
        fits: fits of single recordings, of `identify` and `compare`.
        rows: rows of the windows, of `identify`; None if too little of the motion is clear of stick.
        schemes: results of the schemes, of `identify`.
        trial, diagnosis: of `diagnose`.
        earlier: findings of earlier checks in the list.
    """

    data: FitData
    model: Model
    doubts: Sequence[Finding] = ()
    fits: Sequence[RecordingFit] = ()
    rows: RegressionData | None = None
    schemes: Sequence[Identified] = ()
    trial: Trial | None = None
    diagnosis: Diagnosis | None = None
    earlier: tuple[Finding, ...] = ()

    @classmethod
    def from_trial(cls, trial: Trial, diagnosis: Diagnosis) -> Subject:
        """Return the subject of a diagnosis without findings."""
        model = trial.release_bounds(diagnosis.model)
        return cls(trial.data.whole or trial.data, model, trial.doubts, trial=trial, diagnosis=diagnosis)

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the model."""
        return tuple(self.model.terms)

    @property
    def is_arm(self) -> bool:
        """Return whether the model is that of an arm."""
        return not self.model.body.can_simulate

    @property
    def is_in_loop(self) -> bool:
        """Return whether the model was found by simulations of servos with their controller."""
        return self.diagnosis is not None and self.diagnosis.steps[0].errors["holdout"].is_in_loop

    @property
    def is_fitted(self) -> bool:
        """Return whether all parameters of the model were fitted to the recordings, by `identify` or `diagnose`."""
        return bool(self.schemes) or self.diagnosis is not None

    @property
    def pendulum(self) -> tuple[Trial, Diagnosis] | None:
        """Trial and diagnosis of a pendulum without a reversed torque; None for other subjects."""
        if self.trial is None or self.diagnosis is None or self.is_arm or self.is_in_loop:
            return None
        causes = [region.cause for region in self.diagnosis.unexplained]
        return None if any(isinstance(cause, WrongColumn) for cause in causes) else (self.trial, self.diagnosis)


def examine(subject: Subject) -> tuple[Finding, ...]:
    """Return the findings of all checks of a subject."""
    findings: tuple[Finding, ...] = ()
    for check in CHECKS:
        findings = (*findings, *check(replace(subject, earlier=findings)))
    return findings


def check_conventions(subject: Subject) -> Iterable[Finding]:
    """Report the decided conventions of drives."""
    return list_decisions(subject.data.treatments) if subject.is_fitted else ()


def check_payloads(subject: Subject) -> Iterable[Finding]:
    """Report payloads of an arm."""
    return [treatment for treatment in subject.data.treatments if isinstance(treatment, CarriedPayload)]


def check_columns(subject: Subject) -> Iterable[Finding]:
    """Find a column with a wrong sign or zero, or friction that drives; of an arm friction alone."""
    if not subject.is_fitted:
        return ()
    if subject.is_arm:
        return find_driving_friction(subject.model)
    known, recordings = subject.diagnosis, subject.data.recordings
    if known is None:
        return find_remedies(subject.model, recordings, criterion=subject.data.criterion)
    return find_remedies(subject.model, recordings, known.ambiguous, not known.unexplained, subject.data.criterion)


def check_torque_constant(subject: Subject) -> Iterable[Finding]:
    """Report an unknown torque constant or inertia, and, in a diagnosis of a pendulum, errors of the constant."""
    data, constant = subject.data, subject.data.recordings[0].torque_constant
    doubts = [data.doubt] if data.doubt is not None else []
    if subject.diagnosis is None or constant is None or subject.is_arm or subject.is_in_loop:
        return doubts
    return [*doubts, *find_gain_doubts(subject.diagnosis.model, constant, data.parts[0].data, data.criterion)]


def check_timing(subject: Subject) -> Iterable[Finding]:
    """Find torque that is logged late, corrected in a diagnosis, or that acts late.

    Torque that acts late is no finding if the identified model has a dead time or a lag. A diagnosis reports it with a
    found dead time or lag, or with an unexplained residual if the selected effects do not explain the delay.
    """
    if subject.diagnosis is None or subject.trial is None:
        if subject.rows is None or subject.is_arm:
            return ()
        timing = subject.data.with_timing().timing
        has_delay = any(term.delays_torque for term in subject.terms)
        return [*timing.find(is_late=True), *(() if has_delay else timing.find(is_late=False))]
    timing, diagnosis = subject.data.timing, subject.diagnosis
    late, slow = timing.corrections, () if subject.is_arm else timing.find(is_late=False)
    library, found = subject.trial.options.library, {id for group in diagnosis.effects for id in group}
    if not slow or any(library[id]().delays_torque for id in found & library.keys()):
        return [*late, *slow]
    if not diagnosis.unexplained:
        return late
    effects = [term for term in diagnosis.model.terms if term.id in diagnosis.selected]
    return [*late, *subject.data.with_timing(effects).timing.find(is_late=False)]


def check_agreement(subject: Subject) -> Iterable[Finding]:
    """Find recordings that disagree with the others or with a model, and those that no parameters fit."""
    if subject.trial is not None:
        return () if subject.is_arm or subject.is_in_loop else subject.trial.outliers
    fits = subject.fits
    if subject.is_fitted:
        return [*find_disagreements(fits, only_if_all_fit=True), *find_misfits(fits)]
    return [*find_disagreements_with_model(subject.model, fits), *find_misfits(fits)]


def check_completeness(subject: Subject) -> Iterable[Finding]:
    """Test whether an identified model explains the recordings, unless an earlier finding explains the residual."""
    explanations = WrongColumn | NegativeParameters | TorqueTiming | Disagreement
    is_explained = any(isinstance(finding, explanations) for finding in subject.earlier)
    if subject.rows is None or (is_explained and not subject.is_arm):
        return ()
    return find_incompleteness(subject.schemes, subject.rows, subject.terms, subject.data.criterion)


def check_clock(subject: Subject) -> Iterable[Finding]:
    """Find an uneven clock, which may cause the residual of a pendulum."""
    is_left = any(isinstance(finding, Incomplete) for finding in subject.earlier)
    if subject.diagnosis is not None:
        is_left = bool(subject.diagnosis.unexplained)
    return find_uneven_clocks(subject.data.recordings) if is_left and not (subject.is_arm or subject.is_in_loop) else ()


def check_feedback(subject: Subject) -> Iterable[Finding]:
    """Find torque that reacts to the motion; the controller of servos is known."""
    is_tested = subject.is_fitted and not (subject.is_arm or subject.is_in_loop)
    return find_feedback(subject.data.recordings, subject.data.criterion) if is_tested else ()


def check_contacts(subject: Subject) -> Iterable[Finding]:
    """Find contacts that no effect of a diagnosis explains."""
    if subject.pendulum is not None:
        trial, diagnosis = subject.pendulum
        return find_contacts(trial.final.evidence, trial.terms, diagnosis.model)
    if subject.trial is None or subject.diagnosis is None or not subject.is_arm:
        return ()
    trial, diagnosis = subject.trial, subject.diagnosis
    explained = {*diagnosis.joint_residuals, *(term.at for term in trial.terms if term.has_impacts)}
    joints = [joint for joint in diagnosis.model.body.joints if joint not in explained]
    return find_arm_contacts(trial.evidence, diagnosis.model, joints)


def check_ties(subject: Subject) -> Iterable[Finding]:
    """Report effects of a pendulum that look the same."""
    return [] if subject.pendulum is None else [*map(Tie, subject.pendulum[1].ambiguous)]


def check_rotors(subject: Subject) -> Iterable[Finding]:
    """Find joints of an arm whose motor inertia the robot file lacks."""
    selected = () if subject.diagnosis is None else subject.diagnosis.selected
    joints = tuple(term.at for term in subject.terms if isinstance(term, Rotor) and term.id in selected)
    return [MissingRotors(joints)] if joints else []


def check_parameters(subject: Subject) -> Iterable[Finding]:
    """Report parameters that the recordings do not determine, and changed filters."""
    return subject.doubts if subject.trial is None or subject.pendulum is not None else ()


def check_unlogged_torque(subject: Subject) -> Iterable[Finding]:
    """Find torque noise that is not logged, in a diagnosis of a pendulum without another residual."""
    if subject.pendulum is None or subject.pendulum[1].unexplained or withhold_everything(subject.doubts):
        return ()
    return find_noise_not_logged(subject.pendulum[0].final)


def check_limits_of_motion(subject: Subject) -> Iterable[Finding]:
    """Find limits of the recordings within which the values of a pendulum hold, see `find_caveats`."""
    if subject.pendulum is None:
        return ()
    trial, diagnosis = subject.pendulum
    return find_caveats(trial.final.evidence, diagnosis.steps, trial.terms, diagnosis.detectable)


def check_drive(subject: Subject) -> Iterable[Finding]:
    """Find an unknown rate of the speed of a drive, and a scale of the logged torque."""
    if not subject.is_in_loop:
        return ()
    recordings, limits = subject.data.recordings, subject.data.criterion.loop
    return filter(None, (find_speed_rate(subject.model, recordings, limits), find_torque_scale(recordings, limits)))


def check_tables(subject: Subject) -> Iterable[Finding]:
    """Report tables that explain the residual of a pendulum, unless they are the next step."""
    if subject.pendulum is None or not subject.pendulum[1].tables:
        return ()
    finding = NoKnownEffect(subject.pendulum[1].tables)
    return [finding] if finding != subject.pendulum[1].no_experiment else []


def check_small_effect(subject: Subject) -> Iterable[Finding]:
    """Find an effect that predicts better and explains too little."""
    return () if subject.diagnosis is None else find_small_effect(subject.diagnosis)


Check = Callable[[Subject], Iterable[Finding]]
CHECKS: tuple[Check, ...] = (
    check_conventions,
    check_payloads,
    check_columns,
    check_torque_constant,
    check_timing,
    check_agreement,
    check_completeness,
    check_clock,
    check_feedback,
    check_contacts,
    check_ties,
    check_rotors,
    check_parameters,
    check_unlogged_torque,
    check_limits_of_motion,
    check_drive,
    check_tables,
    check_small_effect,
)
