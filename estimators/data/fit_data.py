"""Data of a fit: recordings with calibrated and timed torque, split, and cut into windows and segments.

`diagnose`, `compare`, `add`, `fit`, `identify`, the report and the app use the same data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Self

from estimators.checks.homogeneity import Disagreement
from estimators.data.calibration import calibrate, make_constant_finding
from estimators.data.preparation import find_preparation
from estimators.data.regression_data import RegressionData
from estimators.data.shared_clock import share_clock
from estimators.data.split import CutSettings, Parts, add_contacts, split_arm
from estimators.data.timing import Timing
from estimators.data.treatment import Action, Treatment
from estimators.decisions.criterion import Criterion
from estimators.findings import Finding
from estimators.free_swings import find_known_values
from pendulum_env.physics import BASE, Estimate, Term
from pendulum_env.physics.joints import find_mechanism
from pendulum_env.recording import Recording


@dataclass(frozen=True, eq=False)
class FitData:
    """Recordings to fit and to hold out, and their treatments; each treatment returns new data.

    Attributes:
        recordings: to fit; torque in N m if the torque constant is known, else in the unit of the log.
        holdout: to check on; if empty, the end of each fitted recording is held out.
        doubt: finding if the torque constant, or the inertia of free swings, is unknown; else None.
        timing: time between torque and motion of each recording, fitted ones first. Empty before `with_timing`.
        cut: how recordings of a pendulum are cut into windows and segments.
        terms: terms that may be fitted to a linked mechanism, the links first; empty for a pendulum.
        treatments: findings on each treatment, in order.
        excluded: disagreements of the recordings that were excluded from the fit.
        whole: the data before recordings were excluded; None without exclusion.
        criterion: limits of the decisions on the data.
    """

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...] = ()
    doubt: Finding | None = None
    timing: Timing = field(default_factory=Timing)
    cut: CutSettings = field(default_factory=CutSettings)
    terms: tuple[type[Term] | Term, ...] = ()
    treatments: tuple[Finding, ...] = ()
    excluded: tuple[Disagreement, ...] = ()
    whole: FitData | None = None
    criterion: Criterion = Criterion()

    @classmethod
    def from_recordings(
        cls,
        recordings: Sequence[Recording],
        holdout: Sequence[Recording] = (),
        terms: Sequence[Term | type[Term]] = (),
        *,
        known: Mapping[str, float] | None = None,
        criterion: Criterion = Criterion(),
    ) -> Self:
        """Return data with torque in N m, by the known loads of fitted recordings.

        Free swings alone are in N m if a parameter is known, else relative to the inertia. Currents with links, and of
        a controller with an integral part, are not converted.

        Args:
            recordings: to fit.
            holdout: to check on.
            terms: of the base model; with links all terms that may be fitted, the links first.
            known: known parameters by name, which scale free swings; by default those of the terms.
            criterion: limits of the decisions.

        Raises:
            IdentificationError: if units differ; if the joint moves too little; or if
                torque is applied in held-out recordings only and no parameter is known.
        """
        combined, count = share_clock((*recordings, *holdout)), len(recordings)
        recordings, holdout = combined[:count], combined[count:]
        if not find_mechanism(terms).can_simulate:
            return cls(recordings, holdout, terms=tuple(terms), criterion=criterion)
        base = [term for term in terms if isinstance(term, Term)]
        known = find_known_values(base) if known is None else known
        fitted, held_out, doubt = calibrate(recordings, holdout, None, known, criterion)
        treatments = () if (own := fitted[0].torque_constant) is None else (make_constant_finding(own),)
        preparation = find_preparation((*fitted, *held_out))
        fitted, held_out, findings = preparation.decide_torque(fitted, held_out, base or BASE, criterion)
        cut = CutSettings(base=tuple(base) or BASE, inertia=known.get("inertia"))
        treatments = *treatments, *findings
        return cls(fitted, held_out, doubt, cut=cut, treatments=treatments, criterion=criterion)

    @property
    def base_terms(self) -> list[Term]:
        """Terms of the base model with links; empty for a pendulum."""
        return [term for term in self.terms if isinstance(term, Term)]

    def with_treatment(self, treatment: Finding, **changes: Any) -> Self:
        """Return the data with changed fields, and a finding on the treatment added to `treatments`."""
        return replace(self, treatments=(*self.treatments, treatment), **changes)

    @property
    def actions(self) -> list[str]:
        """Actions of the treatments, in order."""
        return [treatment.action for treatment in self.treatments if isinstance(treatment, Treatment)]

    def with_timing(self, effects: Sequence[Term] | None = None) -> FitData:
        """Return the data with torque corrected by its estimated delay and filter.

        They are estimated under the base model with some effects; under None, beside nearly any law of the joint.

        Recordings share an alignment, unless their own estimates contradict it, see `estimate_alignments`. Held-out and
        excluded recordings count, since the timing belongs to the log: `whole` is timed, and the same recordings are
        excluded again. The estimation starts from untimed data. Findings on effects and corrections replace earlier
        corrections.
        """
        if self.whole is not None:
            return self.whole.with_timing(effects).without_outliers(self.excluded)
        logged, terms = self.timing.logged or self.all_recordings, [*self.base_terms, *(effects or ())]
        timing = Timing.from_recordings(logged, terms, self.criterion, effects is not None)
        return self._correct_torque(timing, effects)

    def with_shorter_delay(self, joint: str, dead_time: Estimate, effects: Sequence[Term]) -> FitData:
        """Return the data with the delay of late torque at a joint shorter by a dead time, found beside `effects`."""
        if self.whole is not None:
            return self.whole.with_shorter_delay(joint, dead_time, effects).without_outliers(self.excluded)
        return self._correct_torque(self.timing.reduce_delays(joint, dead_time.value, dead_time.std), effects)

    def _correct_torque(self, timing: Timing, effects: Sequence[Term] | None) -> FitData:
        """Return the data with torque corrected by a timing, under some effects or, for None, beside nearly any law."""
        corrected, count, corrections = timing.recordings, len(self.recordings), self.timing.corrections
        earlier = [treatment for treatment in self.treatments if treatment not in corrections]
        if effects is not None:
            earlier.append(Treatment(Action.TIMED_BY_MODEL, effects=tuple(term.id for term in effects)))
        treatments = (*earlier, *timing.corrections)
        changes: dict[str, Any] = {"recordings": corrected[:count], "holdout": corrected[count:]}
        return replace(self, **changes, timing=timing, treatments=treatments)

    def without_timing(self) -> FitData:
        """Return the data with torque as logged: with no correction of its delay and filter."""
        if self.whole is not None:
            return self.whole.without_timing().without_outliers(self.excluded)
        logged, count = self.timing.logged or self.all_recordings, len(self.recordings)
        corrections = self.timing.corrections
        others = (treatment for treatment in self.treatments if treatment not in corrections)
        earlier = (one for one in others if not (isinstance(one, Treatment) and one.action is Action.TIMED_BY_MODEL))
        treatments = (*earlier, Treatment(Action.TIMED_AS_LOGGED))
        changes: dict[str, Any] = {"recordings": logged[:count], "holdout": logged[count:]}
        return replace(self, **changes, timing=Timing(), treatments=treatments)

    def without_outliers(self, outliers: Sequence[Disagreement]) -> FitData:
        """Return the data without the fitted recordings of some disagreements, and with `whole` set to these data.

        Disagreements number recordings from 1, fitted ones first; held-out ones stay. Without a fitted one, the same
        data are returned.
        """
        excluded, count = {outlier.number for outlier in outliers}, len(self.recordings)
        remaining_numbers = [k for k in range(count) if k + 1 not in excluded]
        if len(remaining_numbers) == count:
            return self
        timed_numbers = (*remaining_numbers, *range(count, len(self.timing.alignments)))
        names = tuple(recording.name for k, recording in enumerate(self.recordings) if k not in remaining_numbers)
        return self.with_treatment(
            Treatment(Action.RECORDINGS_EXCLUDED, recordings=names),
            recordings=tuple(self.recordings[k] for k in remaining_numbers),
            timing=self.timing.select(timed_numbers),
            excluded=tuple(outliers),
            whole=self,
        )

    def with_contacts(self, terms: Sequence[Term]) -> Self:
        """Return the data with contacts with a stop, by the residual of some terms; the same data if they are few."""
        parts = add_contacts(self.parts, terms)
        if parts is self.parts:
            return self
        cut = replace(self.cut, contact_terms=tuple(terms))
        return self.with_treatment(Treatment(Action.IMPACTS_INCLUDED, n_assumptions=1), cut=cut).with_parts(parts)

    def with_parts(self, parts: Parts) -> Self:
        """Set the cached `parts` of this object, and return it."""
        vars(self)["parts"] = parts
        return self

    def with_horizon(self, horizon: float | None) -> Self:
        """Return the data with segments of another length [s]; see `RegressionData.with_horizon`; unchanged by None."""
        if horizon is None:
            return self
        train, holdout = (part.with_horizon(horizon) for part in self.parts)
        return replace(self, cut=replace(self.cut, horizon=horizon)).with_parts((train, holdout))

    def without_history(self, terms: tuple[Term, ...] = ()) -> Self:
        """Return the data without memoised results, `whole` and logged torque; with links, with `terms` instead."""
        timing = replace(self.timing, logged=())
        result = replace(self, terms=terms if self.terms else (), whole=None, timing=timing)
        if "parts" in vars(self):
            train, holdout = map(replace, self.parts)
            result.with_parts((train, holdout))
        return result

    @cached_property
    def parts(self) -> Parts:
        """Fitted and held-out data as windows and segments.

        Raises:
            IdentificationError: if a part holds too little motion, or torque is never applied.
        """
        if self.terms:
            train, holdout = split_arm(self.recordings, self.holdout)
            cut = partial(RegressionData.from_arm, terms=self.terms, block=self.criterion.block)
            fitted = cut(train)
            return fitted, cut(holdout) if self.holdout else cut(holdout, fitted=fitted.data)
        return self.cut.make_parts(self.recordings, self.holdout, self.criterion)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without `parts`, which are large and computed again."""
        return {name: value for name, value in vars(self).items() if name != "parts"}

    @property
    def is_comparison(self) -> bool:
        """Return whether fitted and held-out recordings are the same object: a comparison without a fit."""
        return self.holdout is self.recordings

    @property
    def all_recordings(self) -> tuple[Recording, ...]:
        """All recordings, fitted ones first."""
        return self.recordings if self.is_comparison else (*self.recordings, *self.holdout)
