"""Case of an arm: effects at its joints by the torque of all joints, without simulation and suggestion."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimators.data.fit_data import FitData
from estimators.data.standard_errors import widen_by_timing
from estimators.decisions.errors import Step
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.checks import (
    check_completeness_of_arm,
    check_contacts_of_arm,
    check_corrected_timing,
    check_friction,
    check_parameters,
    check_payloads,
    check_rotors,
    check_small_effect,
    check_torque_constant,
)
from estimators.diagnosis.conclusion import conclude_arm
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis
from estimators.diagnosis.treatments import align_with_effects, include_payload
from estimators.diagnosis.unexplained import find_joint_residuals
from estimators.findings import Finding
from estimators.schemes.identifiability import find_undetermined_links
from estimators.selection.evidence import Evidence
from estimators.selection.search import SearchResult
from estimators.signals.residual import Region
from estimators.weak_form.averages import concatenate_samples
from pendulum_env.arms.joints import find_body, find_links, place_effects
from pendulum_env.physics import TABLES, Term, list_ids
from pendulum_env.recording import Recording


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
        check_contacts_of_arm,
        check_rotors,
        check_parameters,
        check_small_effect,
    )

    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether the first term has the links of an arm."""
        return not find_body(base).can_simulate

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
        return options.make_evidence(data.parts, place_effects(TABLES.values(), find_links(options.base)))

    def refine(self, trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
        """Return the result without parameters of links that the recordings do not determine, and no findings."""
        *others, last = trial.result.steps
        body, data = find_links(trial.options.base), trial.evidence.train.data
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

    def conclude(self, trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
        """Add the residual of each joint, tables that explain it, and the next step."""
        return conclude_arm(trial, diagnosis)


ARM = Arm()
