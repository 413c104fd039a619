"""Data of a fit: recordings with calibrated and timed torque, split, and cut into windows and segments.

`diagnose`, `compare`, `add`, `fit`, `identify`, the report and the app use the same data.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from estimators.checks.alignment import Alignment
from estimators.checks.channel import align_each
from estimators.checks.homogeneity import Disagreement
from estimators.data.calibration import calibrate
from estimators.data.regression_data import RegressionData
from estimators.data.split import Parts, split_arm, split_recordings, with_contacts
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import find_known_values
from estimators.in_loop.rollouts import LoopMotion, simulate_in_loop
from pendulum_env.arms.joints import find_body
from pendulum_env.physics import Model, Term
from pendulum_env.recording import Recording, TorqueConstant


@dataclass(frozen=True, eq=False)
class FitData:
    """Recordings as models are fitted to them, and their treatments; each treatment returns new data.

    Attributes:
        recordings: to fit; in N m if the torque constant is known, else in the unit of the log.
        holdout: to check on; if there are none, the end of each recording is held out.
        doubt: finding if the torque constant is unknown; None if it is known, or torque was logged.
        alignments: time between torque and motion in each recording, fitted ones first; torque that was logged late or
            filtered is corrected by it. Empty before `timed`.
        window_share: length of the windows, relative to the length that the noise asks for.
        contact_terms: terms by whose residual windows in contact with a stop were added; None if none were.
        terms: of an arm, that may be fitted to it, the links first.
        treatments: of the recordings, in order.
        excluded: recordings that disagree with the others, and are not fitted.
        whole: the data before recordings were excluded; None if none was.
        untimed: the data before torque was timed; None if it was not.
        horizon: length of the segments for simulation [s]; None for the usual one.
    """

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...] = ()
    doubt: Finding | None = None
    alignments: tuple[Alignment, ...] = ()
    window_share: float = 1.0
    contact_terms: tuple[Term, ...] | None = None
    terms: tuple[type[Term] | Term, ...] = ()
    treatments: tuple[Finding, ...] = ()
    excluded: tuple[Disagreement, ...] = ()
    whole: FitData | None = None
    untimed: FitData | None = None
    horizon: float | None = None

    @classmethod
    def from_recordings(
        cls,
        recordings: Sequence[Recording],
        holdout: Sequence[Recording] = (),
        terms: Sequence[Term | type[Term]] = (),
        *,
        constant: TorqueConstant | None = None,
        known: Mapping[str, float] | None = None,
    ) -> Self:
        """Convert torque to N m, by a known torque constant or by the known loads of the fitted recordings.

        Torque that is logged slightly late gives the same constant: to first order its error is odd in the velocity,
        and inertia and gravity of a load are even. Free swings alone are in N m if a parameter is known, or else
        relative to the inertia. Currents of an arm, and of a controller with an integral part, are not converted.

        Args:
            recordings: to fit.
            holdout: to check on.
            terms: of the base model; of an arm all that may be fitted, the links first.
            constant: the torque constant, if it is known.
            known: values of known parameters by name, which scale free swings; by default those of the terms.

        Raises:
            IdentificationError: if units differ, also from that of the constant; if there is too little motion; or if
                torque is applied in held-out recordings only and no parameter is known.
        """
        if not find_body(terms).can_simulate:
            return cls(tuple(recordings), tuple(holdout), terms=tuple(terms))
        known = find_known_values([term for term in terms if isinstance(term, Term)]) if known is None else known
        data = cls(*calibrate(recordings, holdout, constant, known))
        if data.constant is None:
            return data
        value = Quantity(data.constant.value, data.constant.std, data.constant.unit)
        return data.with_treatment(Finding(Kind.TORQUE_CONSTANT, {"torque_constant": value}))

    def with_treatment(self, treatment: Finding, **changes: Any) -> Self:
        """Return the data after one more treatment, with the fields that it changes."""
        return replace(self, treatments=(*self.treatments, treatment), **changes)

    def has_treatment(self, kind: Kind) -> bool:
        """Return whether the data had a treatment."""
        return any(treatment.kind is kind for treatment in self.treatments)

    def with_timing(self, effects: Sequence[Term] = ()) -> FitData:
        """Correct the time between torque and motion under a model with some effects: see `estimators.align`.

        The timing of the log is no part of the model, so held-out and excluded recordings determine it, too.
        """
        if self.whole is not None:
            return self.whole.with_timing(effects).without_outliers(self.excluded)
        raw, terms = self.untimed or self, [term for term in self.terms if isinstance(term, Term)]
        every, count = raw.every, len(raw.recordings)
        alignments = align_each(every, [*terms, *effects])
        moved = tuple(one.apply(recording) for one, recording in zip(alignments, every, strict=True))
        earlier = tuple(treatment for treatment in self.treatments if treatment not in self.corrections)
        changes: dict[str, Any] = {"recordings": moved[:count], "holdout": moved[count:], "untimed": raw}
        timed = replace(self, **changes, alignments=tuple(alignments))
        beside = [Finding(Kind.TIMED_BESIDE, effects=tuple(term.id for term in effects))] if effects else []
        return replace(timed, treatments=(*earlier, *beside, *timed.corrections))

    def without_outliers(self, outliers: Sequence[Disagreement]) -> FitData:
        """Return the data without the fitted recordings that disagree with the others."""
        excluded, count = {one.recording for one in outliers}, len(self.recordings)
        kept = [k for k in range(count) if k + 1 not in excluded]
        if len(kept) == count:
            return self
        alignments = [self.alignments[k] for k in (*kept, *range(count, len(self.alignments))) if self.alignments]
        names = tuple(own.name for k, own in enumerate(self.recordings) if k not in kept)
        return self.with_treatment(
            Finding(Kind.RECORDINGS_EXCLUDED, recordings=names),
            recordings=tuple(self.recordings[k] for k in kept),
            alignments=tuple(alignments),
            excluded=tuple(outliers),
            whole=self,
        )

    def with_changes(self, change: Callable[[Recording], Recording], numbers: Collection[int]) -> Self:
        """Return the data after a change of some recordings, held-out ones numbered behind the fitted ones."""
        every = tuple(change(own) if k in numbers else own for k, own in enumerate(self.every))
        untimed = None if self.untimed is None else self.untimed.with_changes(change, numbers)
        count = len(self.recordings)
        return replace(self, recordings=every[:count], holdout=every[count:], untimed=untimed)

    def with_contacts(self, terms: Sequence[Term]) -> Self:
        """Return the data with windows in contact with a stop, by the residual of some terms; the same if few."""
        parts = with_contacts(self.parts, terms)
        if parts is self.parts:
            return self
        return self.with_treatment(Finding(Kind.IMPACTS_INCLUDED), contact_terms=tuple(terms)).with_parts(parts)

    def with_parts(self, parts: Parts) -> Self:
        """Set the parts, which are not computed again, and return the data."""
        vars(self)["parts"] = parts  # where the cached property keeps them
        return self

    def with_horizon(self, horizon: float | None) -> Self:
        """Return the data with segments of another length [s] for simulation; see `RegressionData.with_horizon`."""
        if horizon is None:
            return self
        train, holdout = (part.with_horizon(horizon) for part in self.parts)
        return replace(self, horizon=horizon).with_parts((train, holdout))

    def without_history(self, terms: tuple[Term, ...] = ()) -> Self:
        """Return the data without memoised columns and earlier data; of an arm, with the given terms only."""
        result = replace(self, terms=terms if self.terms else (), whole=None, untimed=None)
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
            return RegressionData.from_arm(train, self.terms), RegressionData.from_arm(holdout, self.terms)
        parts = split_recordings(self.recordings, self.holdout, self.window_share)
        parts = parts if self.contact_terms is None else with_contacts(parts, self.contact_terms)
        if self.horizon is None:
            return parts
        return parts[0].with_horizon(self.horizon), parts[1].with_horizon(self.horizon)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle all but the parts, which are large and are computed again."""
        return {name: value for name, value in vars(self).items() if name != "parts"}

    @property
    def is_comparison(self) -> bool:
        """Return whether the recordings are compared, all alike, so that nothing is fitted."""
        return self.holdout is self.recordings

    @property
    def every(self) -> tuple[Recording, ...]:
        """All recordings, fitted ones first."""
        return self.recordings if self.is_comparison else (*self.recordings, *self.holdout)

    @property
    def constant(self) -> TorqueConstant | None:
        """Torque constant by which currents were converted; None if they were not."""
        return self.recordings[0].torque_constant

    @property
    def unit(self) -> str:
        """Unit of the torque: `N m`, or that of the log."""
        return self.recordings[0].torque_unit

    @property
    def has_moved(self) -> bool:
        """Return whether any torque was corrected."""
        return any(one.is_late for one in self.alignments)

    def agrees(self, other: FitData) -> bool:
        """Return whether other data have the same corrections of torque, within their standard errors."""
        return all(
            np.isinf(one.delay_std + two.delay_std) or (one.is_late == two.is_late and one.agrees(two))
            for one, two in zip(self.alignments, other.alignments, strict=True)
        )

    @property
    def corrections(self) -> list[Finding]:
        """Findings on torque that was logged late, and that is corrected."""
        kinds = {
            Kind.TORQUE_LATE: Kind.TORQUE_LATE_CORRECTED,
            Kind.TORQUE_SAMPLED: Kind.TORQUE_SAMPLED_CORRECTED,
        }
        return [replace(finding, kind=kinds[finding.kind]) for finding in self.find_timing(True)]

    def simulate_in_loop(self, model: Model) -> LoopMotion:
        """Simulate all recordings, fitted ones first, with their controllers in the loop; empty without controllers."""
        return simulate_in_loop(model, self.every)

    def find_timing(self, is_late: bool) -> tuple[Finding, ...]:
        """Return findings on torque that is logged late, or acts late; with names of recordings if these differ."""
        every = zip(self.every, self.alignments, strict=bool(self.alignments))
        found: list[Finding] = []
        names: list[list[str]] = []
        for recording, one in every:
            if one.is_late != is_late or (finding := one.finding) is None:
                continue
            if finding not in found:
                found, names = [*found, finding], [*names, []]
            names[found.index(finding)].append(recording.name)
        if all(one is self.alignments[0] for one in self.alignments):
            return tuple(found)
        return tuple(replace(one, recordings=tuple(own)) for one, own in zip(found, names, strict=True))
