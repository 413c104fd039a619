"""Interface of a case, a kind of machine that is diagnosed; trials: searches on data under some treatments.

A case has the functions in which diagnoses of machines differ; the driver has no other branches. The case of a
pendulum, `estimators.diagnosis.pendulum`, is the model for others, which `register_case` adds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

from estimators.checks.homogeneity import Disagreement, find_disagreements, fit_each_recording
from estimators.data.fit_data import FitData
from estimators.data.fits import fit_within_laws
from estimators.data.preparation import Preparation
from estimators.decisions.errors import Step, Terms
from estimators.diagnosis.links import LinkPayload, NearestLinks
from estimators.diagnosis.options import Options
from estimators.diagnosis.result import Diagnosis, HorizonRefit
from estimators.findings import Finding
from estimators.selection.evidence import Evidence
from estimators.selection.search import SearchResult, search
from estimators.signals.residual import Region
from pendulum_env.physics import BASE, Model, Term, list_ids
from pendulum_env.recording import Recording

Treatment = Callable[["Trial"], FitData | None]  # data after one more treatment; None if it does not apply


class Case(Preparation, ABC):
    """Kind of machine and recordings with its own data, search and conclusion.

    A case defines the six abstract methods. The others have defaults: recordings as they are, and a search by the rows
    of the evidence, without refit, treatments, checks and an experiment.

    Attributes:
        name: name of the case.
        treatments: candidate treatments of the data, in the order of their trials.
        checks: checks of results, in the order of print; functions of an `estimators.diagnosis.checks.Subject`.
        is_timed: whether the time between torque and motion is corrected first.
        has_free_motion: whether a model gives free-running motion, for experiments and refits to a horizon.
    """

    name: ClassVar[str]
    treatments: ClassVar[tuple[Treatment, ...]] = ()
    checks: ClassVar[tuple[Callable[[Any], Iterable[Finding]], ...]] = ()
    is_timed: ClassVar[bool] = True
    has_free_motion: ClassVar[bool] = False

    @abstractmethod
    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether a base model and recordings belong to the case."""

    def prepares(self, recordings: Sequence[Recording]) -> bool:
        """Return False: the recordings are as those of a pendulum."""
        return False

    @abstractmethod
    def prepare(
        self, recordings: Sequence[Recording], holdout: Sequence[Recording], options: Options
    ) -> tuple[FitData, Options]:
        """Return calibrated data of fitted and held-out recordings, and options with complete base and library."""

    @abstractmethod
    def make_evidence(self, data: FitData, options: Options) -> Evidence:
        """Make the evidence for models: the rows that they predict, fitted and held out."""

    @abstractmethod
    def find_unexplained(self, trial: Trial) -> Sequence[Region]:
        """Return the regions of the residual of the final model of a trial."""

    @abstractmethod
    def present(self, trial: Trial, step: Step, is_final: bool) -> Step:
        """Return a step in the units of the user, with all standard errors."""

    @abstractmethod
    def conclude(self, trial: Trial, diagnosis: Diagnosis) -> Diagnosis:
        """Add the next step to a diagnosis, and findings on it."""

    def search(self, evidence: Evidence) -> SearchResult:
        """Search for effects."""
        return search(evidence)

    def refit(self, found: SearchResult, start: Model | None) -> SearchResult:
        """Refit the steps of a search to the motion, from a start model with a link if given; by default unchanged."""
        return found

    def refine(self, trial: Trial) -> tuple[SearchResult, Sequence[Finding]]:
        """Return the refitted result of a trial, and findings on parameters that the data do not determine."""
        return trial.result, ()

    def find_floors(self, trial: Trial) -> Mapping[str, float]:
        """Return the noise floor of the held-out errors at each joint, by default that of the torque [N m]."""
        return trial.evidence.residuals.holdout_floors

    def show_effect(self, data: FitData, base: Terms, kind: type[Term]) -> FitData:
        """Return data that show an effect beside base terms, for `add`; by default unchanged."""
        return data

    def find_nearest_links(self, model: Model) -> NearestLinks | None:
        """Find the possible links that are nearest to the parameters of a model; None for a machine without links."""
        return None

    def find_payload(
        self, model: Model, carrying: Sequence[Recording], without: Sequence[Recording] = (), joint: str | None = None
    ) -> LinkPayload | None:
        """Find the body at a link in some recordings, by default at the last; None for a machine without links.

        Raises:
            IdentificationError: if the recordings have too little motion.
        """
        return None

    def refit_to_horizon(self, trial: Trial) -> HorizonRefit | None:
        """Refit the final model to free-running motion over the horizon of the options; None without one."""
        return None


@dataclass(frozen=True)
class Part:
    """Part of a machine that is diagnosed alone: recordings, base terms, library and, if given, model of one joint."""

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...]
    base: tuple[Term, ...]
    library: Mapping[str, type[Term]] = field(default_factory=dict)
    model: Model | None = None


class DividedCase(Preparation, ABC):
    """Kind of machine whose joints are diagnosed one by one, each by the case of its recordings."""

    has_free_motion: ClassVar[bool] = False

    @abstractmethod
    def accepts(self, base: Sequence[Term], recordings: Sequence[Recording]) -> bool:
        """Return whether a base model and recordings belong to the case."""

    @abstractmethod
    def divide(
        self,
        base: Sequence[Term],
        recordings: Sequence[Recording],
        holdout: Sequence[Recording] = (),
        library: Mapping[str, type[Term]] | None = None,
        model: Model | None = None,
    ) -> Mapping[str, Part]:
        """Return the parts of the machine by joint, with their models if a model of the machine is given."""

    def select_quick(self, library: Mapping[str, type[Term]]) -> Mapping[str, type[Term]]:
        """Select the effects that a diagnosis tries; by default all."""
        return library

    @abstractmethod
    def join_diagnoses(self, data: FitData, diagnoses: Mapping[str, Diagnosis]) -> Diagnosis:
        """Join the diagnoses of the joints, from data of the machine."""

    @abstractmethod
    def join_steps(self, model: Model, steps: Mapping[str, Step]) -> Step:
        """Join the steps of some joints to that of a model of the machine."""


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

    @property
    def effects(self) -> list[Term]:
        """Terms of the result beyond the base model of a joint."""
        base = list_ids((*BASE, *self.data.base_terms))
        return [term for term in self.result.terms if term.id not in base]

    def present(self, step: Step, is_final: bool) -> Step:
        """Return a step in the units of the user; a final model with an unexplained residual is marked as biased."""
        step = self.case.present(self, step, is_final)
        return replace(step, model=step.model.mark_biased()) if is_final and self.unexplained else step

    @cached_property
    def unbounded_model(self) -> Model | None:
        """Final model refitted within bounds of the laws alone; None if no parameter is at a bound of zero."""
        model = self.model
        has_bound = any(model.estimates[column.name].at_bound for column in model.columns if column.is_of_body)
        return fit_within_laws(self.evidence.train, model.terms) if has_bound else None

    @cached_property
    def unexplained(self) -> tuple[Region, ...]:
        """Regions of the residual of the final model."""
        return tuple(self.case.find_unexplained(self))

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
