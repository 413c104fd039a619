"""Case of a pendulum: effects that explain the recorded torque, confirmed by free-running motion."""

from collections.abc import Sequence
from dataclasses import replace

from estimators.checks.signs import find_driving_friction
from estimators.data.fit_data import FitData
from estimators.data.standard_errors import add_torque_constant, widen_by_timing, widen_ends
from estimators.decisions.errors import Step, Terms
from estimators.diagnosis.angle_error import widen_by_law
from estimators.diagnosis.case import Case, Trial
from estimators.diagnosis.checks import CHECKS
from estimators.diagnosis.conclusion import conclude
from estimators.diagnosis.horizon import refit_to_horizon
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis, HorizonRefit
from estimators.diagnosis.torque_search import find_unexplained_regions, refine, search_by_torque
from estimators.diagnosis.treatments import (
    align_with_effects,
    exclude_outliers,
    include_contacts,
    keep_logged_time,
    narrow_windows,
    scale_noise_by_model,
)
from estimators.findings import Finding
from estimators.free_swings import is_torque_needed, make_swing_terms, restore_known
from estimators.selection.evidence import Evidence
from estimators.selection.refits import refit_by_likelihood
from estimators.selection.search import SearchResult
from estimators.signals.residual import Region
from pendulum_env.physics import Model, Term
from pendulum_env.physics.joints import find_mechanism
from pendulum_env.physics.table import COMPETING
from pendulum_env.recording import Recording


class Pendulum(Case):
    """Pendulum under a known torque, or free swings of it."""

    name = "pendulum"
    treatments = (
        scale_noise_by_model,
        narrow_windows,
        include_contacts,
        exclude_outliers,
        align_with_effects,
        keep_logged_time,
    )
    checks = CHECKS
    has_free_motion = True

    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether the model has one joint, and no controller moves it; the case is the last that is asked."""
        has_controller = any(recording.actuator.is_controller for recording in recordings)
        return find_mechanism(base).can_simulate and not has_controller

    def prepare(
        self, recordings: Sequence[Recording], holdout: Sequence[Recording], options: Options
    ) -> tuple[FitData, Options]:
        """Return calibrated data, and options with the known inertia of free swings in the base."""
        data = FitData.from_recordings(recordings, holdout, options.base, criterion=options.criterion)
        return data, replace(options, base=make_swing_terms(options.base, data.recordings), original=options.base)

    def make_evidence(self, data: FitData, options: Options) -> Evidence:
        """Return the evidence of models; without torque of the motor, tables that need torque do not compete."""
        data.with_horizon(options.horizon)  # raises an error before the search begins
        is_free = not any(recording.torque.any() for recording in data.recordings)  # of motor torque
        return options.make_evidence(
            data.parts, [kind for kind in COMPETING if not (is_free and is_torque_needed(kind))]
        )

    def search(self, evidence: Evidence) -> SearchResult:
        """Search for effects by torque."""
        return search_by_torque(evidence)

    def refit(self, found: SearchResult, start: Model | None) -> SearchResult:
        """Refit by the likelihood of the motion."""
        return refit_by_likelihood(found, start)

    def refine(self, trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
        """Return the result refitted by likelihood, without undetermined parameters, and findings on these."""
        return refine(trial)

    def find_unexplained(self, trial: Trial) -> Sequence[Region]:
        """Return the regions of the residual; none if the recordings determine no parameter."""
        return find_unexplained_regions(trial)

    def present(self, trial: Trial, step: Step, is_final: bool) -> Step:
        """Return a step with all standard errors: of timing, stops and torque constant; known values as given.

        A final step includes the error of the law of the angle. It is biased if friction accelerates, because another
        law acts in its place.
        """
        model = widen_by_timing(step.model, trial.data, trial.evidence.train)
        model = widen_by_law(model, trial.evidence) if is_final else model
        model = widen_ends(model, trial.data.recordings)
        model = add_torque_constant(model, trial.data.parts[0].data)
        if is_final and find_driving_friction(trial.unbounded_model or trial.model):
            model = model.mark_biased()
        return replace(step, model=restore_known(model, trial.options.original, trial.data.recordings))

    def conclude(self, trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
        """Add detectable sizes, tables, and the next experiment."""
        return conclude(trial, diagnosis)

    def show_effect(self, data: FitData, base: Terms, kind: type[Term]) -> FitData:
        """Return data with contacts with a stop."""
        return data.with_contacts(base)

    def refit_to_horizon(self, trial: Trial) -> HorizonRefit | None:
        """Refit the final model to free-running motion over the horizon of the options; None without one."""
        return refit_to_horizon(trial)


PENDULUM = Pendulum()
