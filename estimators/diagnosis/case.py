"""Cases of a diagnosis, and trials: searches on data under some treatments.

A record for each of pendulum, arm and servos holds their differences; the driver has no other branches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from estimators.checks.homogeneity import Disagreement, find_disagreements, fit_each_recording
from estimators.data.fit_data import FitData
from estimators.data.fits import fit_within_laws
from estimators.diagnosis.result import Diagnosis, HorizonRefit
from estimators.diagnosis.setting import Setting
from estimators.findings import Finding
from estimators.selection.errors import Step, Terms
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.search import SearchResult
from estimators.signals.residual import Region
from estimators.weak_form.columns import NOT_NEGATIVE
from pendulum_env.physics import Model, Term, list_ids
from pendulum_env.recording import Recording

Treatment = Callable[["Trial"], FitData | None]  # data after one more treatment; None if it does not apply


@dataclass(frozen=True)
class Case:
    """Functions by which recordings of a pendulum, of an arm, and of servos differ in a diagnosis.

    Attributes:
        takes: whether a base model and recordings are of the case.
        prepare: calibrate recordings, and complete the base model and the library for them.
        evaluator: make the evaluator of models.
        search: search for effects.
        refit: refit the steps of a search by all that the data hold, from a model with a link if one is given.
        refine: refit a trial, drop effects that the refit rejects, and withhold parameters that the data do not
            determine; return findings on these as well.
        unexplained: find regions of the residual of the final model of a trial.
        present: return a step in the units of the user.
        conclude: add findings and the next step to a diagnosis.
        reveal: return data that show a given effect, for an addition to the base model.
        treatments: candidates, in the order in which they are tried.
        is_timed: whether the time between torque and motion is corrected first.
        refit_to_horizon: refit the final model to free-running motion; None where no motion follows from torque alone.
    """

    takes: Callable[[Sequence[Term], Sequence[Recording]], bool]
    prepare: Callable[[Sequence[Recording], Sequence[Recording], Setting], tuple[FitData, Setting]]
    evaluator: Callable[[FitData, Setting], ModelEvaluator]
    search: Callable[[ModelEvaluator], SearchResult]
    refit: Callable[[SearchResult, Model | None], SearchResult]
    refine: Callable[[Trial], tuple[SearchResult, Sequence[Finding]]]
    unexplained: Callable[[Trial], Sequence[Region]]
    present: Callable[[Trial, Step], Step]
    conclude: Callable[[Trial, Diagnosis], Diagnosis]
    reveal: Callable[[FitData, Terms, type[Term]], FitData]
    treatments: tuple[Treatment, ...]
    is_timed: bool = True
    refit_to_horizon: Callable[[Trial], HorizonRefit | None] | None = None


@dataclass(frozen=True, eq=False)
class Trial:
    """A search for effects in data under some treatments."""

    case: Case
    data: FitData
    setting: Setting
    found: SearchResult

    @classmethod
    def search(cls, case: Case, data: FitData, setting: Setting) -> Trial:
        """Search for effects in data."""
        return cls(case, data, setting, case.search(case.evaluator(data, setting)))

    @property
    def evaluator(self) -> ModelEvaluator:
        """Evaluator of the search."""
        return self.found.evaluator

    @cached_property
    def _refined(self) -> tuple[SearchResult, Sequence[Finding]]:
        return self.case.refine(self)

    @property
    def final(self) -> SearchResult:
        """The result refitted by all that the data hold, without parameters that they do not determine."""
        return self._refined[0]

    @property
    def doubts(self) -> Sequence[Finding]:
        """Findings on parameters that the data do not determine."""
        return self._refined[1]

    @property
    def model(self) -> Model:
        """The final model."""
        return self.final.steps[-1].model

    @property
    def terms(self) -> Terms:
        """Terms of the final model, as they were searched for unless the refit dropped some."""
        return (self.found if list_ids(self.found.terms) == list_ids(self.final.terms) else self.final).terms

    def release_bounds(self, model: Model) -> Model:
        """Return a final model as the data alone would have it, where a parameter is at a bound of a body."""
        held = any(own.at_bound and name.partition("@")[0] in NOT_NEGATIVE for name, own in model.estimates.items())
        return fit_within_laws(self.evaluator.train, model.terms) if held else model

    @cached_property
    def unexplained(self) -> tuple[Region, ...]:
        """Regions of the residual of the final model."""
        return tuple(self.case.unexplained(self))

    @cached_property
    def outliers(self) -> tuple[Disagreement, ...]:
        """Recordings that disagree with the others, with those that were excluded before.

        The base models of single recordings are compared only if the final model leaves a residual: an effect may show
        as a difference between recordings alone. If all recordings would be excluded, no more are than before.
        """
        whole = self.data.whole or self.data
        datasets = [part.data for part in (whole.parts if whole.holdout else whole.parts[:1])]
        found = {one.recording: one for one in self.data.excluded}
        named: tuple[Disagreement, ...] = ()
        if self.unexplained and not found:
            named = find_disagreements(fit_each_recording(datasets, self.setting.base), only_if_all_fit=True)
        named = named or find_disagreements(fit_each_recording(datasets, self.model.terms))
        more = found | {one.recording: one for one in named}
        is_any_fitted = any(k + 1 not in more for k in range(len(whole.recordings)))
        return tuple(own for _, own in sorted((more if is_any_fitted else found).items()))
