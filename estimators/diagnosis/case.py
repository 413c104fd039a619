"""Cases of a diagnosis, and trials: searches on data under some treatments.

A record for each of pendulum, arm and servos holds their differences; the driver has no other branches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from estimators.checks.homogeneity import Disagreement, find_disagreements, fit_each_recording
from estimators.data.fit_data import FitData
from estimators.data.fits import fit_within_laws
from estimators.decisions.errors import Step, Terms
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis, HorizonRefit
from estimators.findings import Finding
from estimators.selection.evidence import Evidence
from estimators.selection.search import SearchResult
from estimators.signals.residual import Region
from pendulum_env.physics import Model, Term, list_ids
from pendulum_env.recording import Recording

Treatment = Callable[["Trial"], FitData | None]  # data after one more treatment; None if it does not apply


@dataclass(frozen=True)
class Case:
    """Functions in which diagnoses of a pendulum, an arm and servos differ.

    Attributes:
        accepts: returns whether a base model and recordings belong to the case.
        prepare: maps fitted and held-out recordings to calibrated data, and completes base model and library.
        make_evidence: makes the evidence for models.
        search: searches for effects.
        refit: refits the last step of a search to the motion, from a start model with a link if given.
        refine: returns the refitted result of a trial, without parameters that the data do not determine, and findings
            on these.
        unexplained: returns regions of the residual of the final model of a trial.
        present: returns a step in the units of the user; a final step includes the error of the law of the angle.
        conclude: adds the next step to a diagnosis, and findings on it.
        show_effect: returns data that show an effect, given the base terms and the effect, for `add`.
        treatments: candidate treatments of the data, in the order of their trials.
        is_timed: whether the time between torque and motion is corrected first.
        refit_to_horizon: refits the final model to free-running motion; None if torque alone gives no motion.
    """

    accepts: Callable[[Sequence[Term], Sequence[Recording]], bool]
    prepare: Callable[[Sequence[Recording], Sequence[Recording], Options], tuple[FitData, Options]]
    make_evidence: Callable[[FitData, Options], Evidence]
    search: Callable[[Evidence], SearchResult]
    refit: Callable[[SearchResult, Model | None], SearchResult]
    refine: Callable[[Trial], tuple[SearchResult, Sequence[Finding]]]
    unexplained: Callable[[Trial], Sequence[Region]]
    present: Callable[[Trial, Step, bool], Step]
    conclude: Callable[[Trial, Diagnosis], Diagnosis]
    show_effect: Callable[[FitData, Terms, type[Term]], FitData]
    treatments: tuple[Treatment, ...]
    is_timed: bool = True
    refit_to_horizon: Callable[[Trial], HorizonRefit | None] | None = None


@dataclass(frozen=True, eq=False)
class Trial:
    """Search for effects in data under some treatments.

    Attributes:
        case: functions of the case.
        data: treated recordings.
        options: options.
        result: of the search.
        refit: refitted result; None: that of the case.
    """

    case: Case
    data: FitData
    options: Options
    result: SearchResult
    refit: SearchResult | None = None

    @classmethod
    def search(cls, case: Case, data: FitData, options: Options) -> Trial:
        """Return the trial of a search for effects in data."""
        return cls(case, data, options, case.search(case.make_evidence(data, options)))

    @property
    def evidence(self) -> Evidence:
        """Evidence of the search."""
        return self.result.evidence

    @cached_property
    def _refined(self) -> tuple[SearchResult, Sequence[Finding]]:
        """Final result, and findings on parameters that the data do not determine."""
        return self.case.refine(self) if self.refit is None else (self.refit, ())

    @property
    def final(self) -> SearchResult:
        """Refitted result, without parameters that the data do not determine."""
        return self._refined[0]

    @property
    def doubts(self) -> Sequence[Finding]:
        """Findings on parameters that the data do not determine."""
        return self._refined[1]

    @property
    def model(self) -> Model:
        """Final model."""
        return self.final.steps[-1].model

    @property
    def terms(self) -> Terms:
        """Terms of the final model with nonlinear parameters of the search; of the refit if that dropped terms."""
        return (self.result if list_ids(self.result.terms) == list_ids(self.final.terms) else self.final).terms

    def present(self, step: Step, is_final: bool) -> Step:
        """Return a step in the units of the user; a final model with an unexplained residual is marked as biased."""
        step = self.case.present(self, step, is_final)
        return replace(step, model=step.model.mark_biased()) if is_final and self.unexplained else step

    def release_bounds(self, model: Model) -> Model:
        """Return a model refitted within bounds of the laws alone, if a parameter is at a body's bound; else it."""
        has_bound = any(model.estimates[column.name].at_bound for column in model.columns if column.is_of_body)
        return fit_within_laws(self.evidence.train, model.terms) if has_bound else model

    @cached_property
    def unexplained(self) -> tuple[Region, ...]:
        """Regions of the residual of the final model."""
        return tuple(self.case.unexplained(self))

    @cached_property
    def outliers(self) -> tuple[Disagreement, ...]:
        """Disagreements of recordings with the others, including those already excluded, in order.

        If the final model leaves a residual and no recording was excluded, fits of the base to single recordings are
        compared first. If these agree, fits of the final terms are compared. New disagreements are ignored if no fitted
        recording would remain.
        """
        whole = self.data.whole or self.data
        criterion = self.options.criterion
        datasets = [part.data for part in (whole.parts if whole.holdout else whole.parts[:1])]
        excluded = {disagreement.number: disagreement for disagreement in self.data.excluded}
        new: tuple[Disagreement, ...] = ()
        if self.unexplained and not excluded:
            fits = fit_each_recording(datasets, self.options.base, criterion)
            new = find_disagreements(fits, only_if_all_fit=True)
        new = new or find_disagreements(fit_each_recording(datasets, self.model.terms, criterion))
        combined = excluded | {disagreement.number: disagreement for disagreement in new}
        is_any_fitted = any(k + 1 not in combined for k in range(len(whole.recordings)))
        return tuple(disagreement for _, disagreement in sorted((combined if is_any_fitted else excluded).items()))
