"""Case of an arm: effects at its joints by the torque of all joints, without simulation and suggestion."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from estimators.checks.signs import find_driving_friction
from estimators.data.fit_data import FitData
from estimators.data.standard_errors import widen_by_timing
from estimators.decisions.errors import Step
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.checks import (
    Subject,
    applies_to,
    check_corrected_timing,
    check_parameters,
    check_small_effect,
    check_torque_constant,
)
from estimators.diagnosis.completeness import Incomplete, find_incompleteness
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.treatments import align_with_effects
from estimators.findings import Finding
from estimators.schemes.identifiability import find_undetermined_links
from estimators.selection.evidence import Evidence
from estimators.selection.search import SearchResult
from estimators.signals.residual import Region
from estimators.weak_form.averages import concatenate_samples
from pendulum_env.physics import TABLES, Model, Term, list_ids
from pendulum_env.physics.joints import Rotor, find_mechanism, place_effects
from pendulum_env.recording import Recording
from robots.arms.body import find_body
from robots.arms.carried_payload import CarriedPayload, include_payload
from robots.arms.conclusion import MissingRotors, conclude_arm, find_joint_residuals
from robots.arms.contacts import find_arm_contacts
from robots.arms.frames import find_wrong_frame
from robots.arms.payload import Payload, find_payload
from robots.arms.standard import Nearest, nearest_body


@applies_to("diagnose")
def check_payloads(subject: Subject) -> Iterable[Finding]:
    """Report payloads of an arm."""
    return [treatment for treatment in subject.data.treatments if isinstance(treatment, CarriedPayload)]


@applies_to("identify", "diagnose")
def check_friction(subject: Subject) -> Iterable[Finding]:
    """Find friction of an arm that drives."""
    return find_driving_friction(subject.model)


@applies_to("identify")
def check_completeness_of_arm(subject: Subject) -> Iterable[Finding]:
    """Test whether an identified model explains the recordings."""
    return find_incompleteness(subject.identified_model)


@applies_to("identify", "diagnose")
def check_frames(subject: Subject) -> Iterable[Finding]:
    """Find a joint with another sign or zero than in the robot file, if the model leaves a residual."""
    is_incomplete = any(isinstance(finding, Incomplete) and finding.joints for finding in subject.earlier)
    if subject.diagnosis is not None:
        is_incomplete, base = bool(subject.diagnosis.joint_residuals), subject.found[0].options.base
    else:
        base = subject.terms
    found = find_wrong_frame(subject.data.recordings, base) if is_incomplete else None
    return [] if found is None else [found]


@applies_to("diagnose")
def check_contacts_of_arm(subject: Subject) -> Iterable[Finding]:
    """Find contacts of joints of an arm without another residual or a stop."""
    trial, diagnosis = subject.found
    explained = {*diagnosis.joint_residuals, *(term.at for term in trial.terms if term.has_impacts)}
    joints = [joint for joint in diagnosis.model.mechanism.joints if joint not in explained]
    return find_arm_contacts(trial.evidence, diagnosis.model, joints)


@applies_to("diagnose")
def check_rotors(subject: Subject) -> Iterable[Finding]:
    """Find joints of an arm whose motor inertia the robot file lacks."""
    selected = subject.found[1].selected
    joints = tuple(term.at for term in subject.terms if isinstance(term, Rotor) and term.id in selected)
    return [MissingRotors(joints)] if joints else []


class Arm(Case):
    """Arm of n joints, by the torque of all joints."""

    name = "arm"
    treatments = (include_payload, align_with_effects)
    checks = (
        check_payloads,
        check_friction,
        check_torque_constant,
        check_corrected_timing,
        check_completeness_of_arm,
        check_frames,
        check_contacts_of_arm,
        check_rotors,
        check_parameters,
        check_small_effect,
    )

    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether the first term has the links of an arm."""
        return not find_mechanism(base).can_simulate

    def prepare(
        self, recordings: Sequence[Recording], holdout: Sequence[Recording], options: Options
    ) -> tuple[FitData, Options]:
        """Return uncalibrated data with all terms that may be fitted, and options without base terms in the library."""
        ids = list_ids(options.base)
        library = {id: kind for id, kind in options.library.items() if id not in ids}
        terms: list[Term | type[Term]] = [*options.base, *library.values()]
        data = FitData.from_recordings(recordings, holdout, terms, criterion=options.criterion)
        return data, replace(options, library=library)

    def make_evidence(self, data: FitData, options: Options) -> Evidence:
        """Return the evidence of models; every table competes at every joint."""
        return options.make_evidence(data.parts, place_effects(TABLES.values(), find_body(options.base)))

    def refine(self, trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
        """Return the result without parameters of links that the recordings do not determine, and no findings."""
        *others, last = trial.result.steps
        body, data = find_body(trial.options.base), trial.evidence.train.data
        samples = (concatenate_samples([w.samples for w in data.part(at).windows]) for at in body.joints)
        motion = zip(*((x.position, x.velocity, x.torque) for x in samples), strict=True)
        model = last.model.mark_unknown(find_undetermined_links(last.model, *map(np.column_stack, motion)))
        return replace(trial.result, steps=[*others, replace(last, model=model)]), ()

    def find_unexplained(self, trial: Trial) -> Sequence[Region]:
        """Return a region of the residual for each joint that has one."""
        return find_joint_residuals(trial.evidence, trial.terms)[1]

    def present(self, trial: Trial, step: Step, is_final: bool) -> Step:
        """Return a step with the standard error of the timing."""
        return replace(step, model=widen_by_timing(step.model, trial.data, trial.evidence.train))

    def find_nearest_links(self, model: Model) -> Nearest:
        """Find the links with the base parameters of a model, or the nearest ones."""
        return nearest_body(model)

    def find_payload(
        self, model: Model, carrying: Sequence[Recording], without: Sequence[Recording] = (), joint: str | None = None
    ) -> Payload:
        """Identify the body that the arm carries; see `robots.arms.payload.find_payload`."""
        return find_payload(model, carrying, without, joint)

    def conclude(self, trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
        """Add the residual of each joint, tables that explain it, and the next step."""
        return conclude_arm(trial, diagnosis)


ARM = Arm()
