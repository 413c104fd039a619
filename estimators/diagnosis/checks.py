"""Checks of a result: one list, in the order of print, for `identify`, `compare`, `add` and `diagnose`.

A check is a function of a `Subject` that returns findings. `applies_to` names the verbs to which it applies, if these
are not all; elsewhere it returns none. `CHECKS` are those of a pendulum; another case has its own list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Literal, get_args

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
from estimators.checks.signs import NegativeParameters
from estimators.checks.torque_constant import find_gain_doubts
from estimators.data.fit_data import FitData
from estimators.data.regression_data import RegressionData
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.caveats import find_caveats
from estimators.diagnosis.completeness import IdentifiedModel, Incomplete, find_incompleteness
from estimators.diagnosis.conclusion import NoKnownEffect
from estimators.diagnosis.contacts import find_contacts
from estimators.diagnosis.ranking import Tie
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.small_effect import find_small_effect
from estimators.diagnosis.unexplained import find_noise_not_logged
from estimators.findings import Finding, withhold_everything
from estimators.schemes.fitting import Identified
from estimators.selection.process_noise import UnloggedTorque
from pendulum_env.physics import Model, Term

Verb = Literal["identify", "compare", "add", "diagnose"]


@dataclass(frozen=True)
class Subject:
    """Model and recordings that are checked.

    Attributes:
        verb: function that made the model.
        case: case of the model and the recordings.
        data: recordings with their treatments, before recordings were excluded.
        model: the model; of a diagnosis refitted within bounds of the laws alone.
        doubts: findings of the fit: parameters that the recordings do not determine, and changed filters.
        fits: fits of single recordings, of `identify` and `compare`.
        rows: rows of the windows, of `identify`; None if too little of the motion is clear of stick.
        schemes: results of the schemes, of `identify`.
        trial, diagnosis: of `diagnose`.
        earlier: findings of earlier checks in the list.
    """

    verb: Verb
    case: Case
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
        data, model = trial.data.whole or trial.data, trial.unbounded_model or diagnosis.model
        return cls("diagnose", trial.case, data, model, trial.doubts, trial=trial, diagnosis=diagnosis)

    @property
    def found(self) -> tuple[Trial, Diagnosis]:
        """Trial and diagnosis, for checks of `diagnose` alone."""
        assert self.trial is not None and self.diagnosis is not None
        return self.trial, self.diagnosis

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the model."""
        return tuple(self.model.terms)

    @property
    def identified_model(self) -> IdentifiedModel | None:
        """Model of the schemes on its rows; None without rows."""
        if self.rows is None:
            return None
        return IdentifiedModel(self.schemes, self.rows, self.terms, self.data.criterion)

    @property
    def has_reversed_torque(self) -> bool:
        """Return whether the sign of the logged torque is reversed in a diagnosis, so that its model is of no use."""
        regions = () if self.diagnosis is None else self.diagnosis.unexplained
        return any(isinstance(region.cause, WrongColumn) for region in regions)


Check = Callable[[Subject], Iterable[Finding]]


def examine(subject: Subject) -> tuple[Finding, ...]:
    """Return the findings of all checks of the case of a subject."""
    findings: tuple[Finding, ...] = ()
    for check in subject.case.checks:
        findings = (*findings, *check(replace(subject, earlier=findings)))
    return findings


def applies_to(*verbs: Verb, needs_sign: bool = False) -> Callable[[Check], Check]:
    """Make a check return no findings for other verbs, and with `needs_sign` under a reversed torque."""

    def limit(check: Check) -> Check:
        @wraps(check)
        def check_if_applicable(subject: Subject) -> Iterable[Finding]:
            is_applicable = subject.verb in (verbs or get_args(Verb))
            return check(subject) if is_applicable and not (needs_sign and subject.has_reversed_torque) else ()

        return check_if_applicable

    return limit


@applies_to("identify", "diagnose")
def check_columns(subject: Subject) -> Iterable[Finding]:
    """Find a column with a wrong sign or zero, or friction that accelerates."""
    criterion = subject.data.criterion
    if subject.verb == "identify":
        return find_remedies(subject.model, subject.data.recordings, criterion=criterion)
    trial, known = subject.found
    recordings = trial.data.recordings  # without excluded ones, which may have another zero
    model = trial.unbounded_model or trial.model  # an angle is a ratio, without errors of timing and units
    return find_remedies(model, recordings, known.ambiguous, not known.unexplained, criterion)


def check_torque_constant(subject: Subject) -> Iterable[Finding]:
    """Report an unknown torque constant or inertia."""
    return [subject.data.doubt] if subject.data.doubt is not None else []


@applies_to("diagnose")
def check_gain(subject: Subject) -> Iterable[Finding]:
    """Find gear losses and back-EMF in the torque constant."""
    data, constant, (_, diagnosis) = subject.data, subject.data.recordings[0].torque_constant, subject.found
    return [] if constant is None else find_gain_doubts(diagnosis.model, constant, data.parts[0].data, data.criterion)


@applies_to("identify")
def check_timing(subject: Subject) -> Iterable[Finding]:
    """Find torque that is logged late, or that acts late if the model has no dead time or lag."""
    if subject.rows is None:
        return ()
    timing, has_delay = subject.data.with_timing().timing, any(term.delays_torque for term in subject.terms)
    return [*timing.find(is_late=True), *(() if has_delay else timing.find(is_late=False))]


@applies_to("diagnose")
def check_corrected_timing(subject: Subject) -> Iterable[Finding]:
    """Report torque that was logged late and is corrected."""
    return subject.data.timing.corrections


@applies_to("diagnose")
def check_slow_torque(subject: Subject) -> Iterable[Finding]:
    """Find torque that acts late: by a found dead time or lag, or if an unexplained residual has no other delay."""
    (trial, diagnosis), slow = subject.found, subject.data.timing.find(is_late=False)
    library, found = trial.options.library, {id for group in diagnosis.effects for id in group}
    if not slow or any(library[id]().delays_torque for id in found & library.keys()):
        return slow
    effects = [term for term in diagnosis.model.terms if term.id in diagnosis.selected]
    return subject.data.with_timing(effects).timing.find(is_late=False) if diagnosis.unexplained else ()


@applies_to("identify", "compare", "diagnose")
def check_agreement(subject: Subject) -> Iterable[Finding]:
    """Find recordings that disagree with the others or with a model, and those that no parameters fit."""
    if subject.verb == "diagnose":
        return subject.found[0].outliers
    if subject.verb == "identify":
        return [*find_disagreements(subject.fits, only_if_all_fit=True), *find_misfits(subject.fits)]
    return [*find_disagreements_with_model(subject.model, subject.fits), *find_misfits(subject.fits)]


@applies_to("identify")
def check_completeness(subject: Subject) -> Iterable[Finding]:
    """Test whether an identified model explains the recordings, unless an earlier finding explains the residual."""
    explanations = WrongColumn | NegativeParameters | TorqueTiming | Disagreement
    is_explained = any(isinstance(finding, explanations) for finding in subject.earlier)
    has_parameters = not withhold_everything(subject.doubts)
    return find_incompleteness(subject.identified_model) if has_parameters and not is_explained else ()


@applies_to("identify", "diagnose")
def check_clock(subject: Subject) -> Iterable[Finding]:
    """Find an uneven clock, which may cause the residual."""
    is_left = any(isinstance(finding, Incomplete | UnloggedTorque) for finding in subject.earlier)
    if subject.verb == "diagnose":
        is_left = bool(subject.found[1].unexplained)
    return find_uneven_clocks(subject.data.recordings) if is_left else ()


@applies_to("identify", "diagnose")
def check_feedback(subject: Subject) -> Iterable[Finding]:
    """Find torque that reacts to the motion."""
    return find_feedback(subject.data.recordings, subject.data.criterion)


@applies_to("diagnose", needs_sign=True)
def check_contacts(subject: Subject) -> Iterable[Finding]:
    """Find contacts that no effect of a pendulum explains."""
    trial, _ = subject.found
    return find_contacts(trial.final.evidence, trial.terms, trial.model)


@applies_to("diagnose", needs_sign=True)
def check_ties(subject: Subject) -> Iterable[Finding]:
    """Report effects that look the same."""
    return map(Tie, subject.found[1].ambiguous)


@applies_to("identify", "diagnose", needs_sign=True)
def check_parameters(subject: Subject) -> Iterable[Finding]:
    """Report parameters that the recordings do not determine, and changed filters."""
    return subject.doubts


@applies_to("diagnose", needs_sign=True)
def check_unlogged_torque(subject: Subject) -> Iterable[Finding]:
    """Find torque noise that is not logged, without another residual."""
    trial, diagnosis = subject.found
    is_left = bool(diagnosis.unexplained) or withhold_everything(subject.doubts)
    return () if is_left else find_noise_not_logged(trial.final)


@applies_to("diagnose", needs_sign=True)
def check_range(subject: Subject) -> Iterable[Finding]:
    """Find limits of the recordings within which the values of a model hold, see `find_caveats`."""
    trial, diagnosis = subject.found
    return find_caveats(trial.final.evidence, diagnosis.steps, trial.terms, diagnosis.detectable)


@applies_to("diagnose", needs_sign=True)
def check_tables(subject: Subject) -> Iterable[Finding]:
    """Report tables that explain the residual, unless they are the next step."""
    _, diagnosis = subject.found
    finding = NoKnownEffect(diagnosis.tables)
    return [finding] if diagnosis.tables and finding != diagnosis.no_experiment else []


@applies_to("diagnose")
def check_small_effect(subject: Subject) -> Iterable[Finding]:
    """Find an effect that predicts better and explains too little."""
    return find_small_effect(subject.found[1])


CHECKS: tuple[Check, ...] = (
    check_columns,
    check_torque_constant,
    check_gain,
    check_timing,
    check_corrected_timing,
    check_slow_torque,
    check_agreement,
    check_completeness,
    check_clock,
    check_feedback,
    check_contacts,
    check_ties,
    check_parameters,
    check_unlogged_torque,
    check_range,
    check_tables,
    check_small_effect,
)
