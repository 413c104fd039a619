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
from estimators.data.split import Parts, add_contacts, split_arm, split_recordings
from estimators.findings import Finding, Kind, Quantity
from estimators.free_swings import find_known_values
from estimators.in_loop import decide_conventions, has_open_torque
from pendulum_env.arms.joints import find_body
from pendulum_env.physics import BASE, Term
from pendulum_env.recording import Recording, TorqueConstant


@dataclass(frozen=True, eq=False)
class FitData:
    """Recordings to fit and to hold out, and their treatments; each treatment returns new data.

    Attributes:
        recordings: to fit; torque in N m if the torque constant is known, else in the unit of the log.
        holdout: to check on; if empty, the end of each fitted recording is held out.
        doubt: finding if the torque constant, or the inertia of free swings, is unknown; else None.
        alignments: time between torque and motion of each recording, fitted ones first, by which late or filtered
            torque is corrected. Empty before `with_timing`.
        window_share: factor on the window lengths chosen by noise.
        inertia: known inertia of a pendulum, which scales encoder noise [kg m^2]; None if the base model gives it.
        contact_terms: terms of the residual that showed contacts with a stop; None without contacts.
        terms: terms that may be fitted to an arm, the links first; empty for a pendulum.
        treatments: findings on each treatment, in order.
        excluded: disagreements of the recordings that were excluded from the fit.
        whole: the data before recordings were excluded; None without exclusion.
        untimed: the data before torque was timed; None before.
        horizon: length of the segments for simulation [s]; None for the default.
    """

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...] = ()
    doubt: Finding | None = None
    alignments: tuple[Alignment, ...] = ()
    window_share: float = 1.0
    inertia: float | None = None
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
        """Return data with torque in N m, by the known torque constant or the known loads of fitted recordings.

        Free swings alone are in N m if a parameter is known, else relative to the inertia. Currents of an arm, and of
        a controller with an integral part, are not converted.

        Args:
            recordings: to fit.
            holdout: to check on.
            terms: of the base model; of an arm all terms that may be fitted, the links first.
            constant: known torque constant.
            known: known parameters by name, which scale free swings; by default those of the terms.

        Raises:
            IdentificationError: if units differ, also from that of the constant; if the joint moves too little; or if
                torque is applied in held-out recordings only and no parameter is known.
        """
        if not find_body(terms).can_simulate:
            return cls(tuple(recordings), tuple(holdout), terms=tuple(terms))
        known = find_known_values([term for term in terms if isinstance(term, Term)]) if known is None else known
        data = cls(*calibrate(recordings, holdout, constant, known), inertia=known.get("inertia"))
        if data.constant is not None:
            quantity = Quantity(data.constant.value, data.constant.std, data.constant.unit)
            data = data.with_treatment(Finding(Kind.TORQUE_CONSTANT, {"torque_constant": quantity}))
        if not has_open_torque(data.all_recordings):
            return data
        return data.decide_conventions([term for term in terms if isinstance(term, Term)] or BASE)

    def with_treatment(self, treatment: Finding, **changes: Any) -> Self:
        """Return the data with changed fields, and a finding on the treatment added to `treatments`."""
        return replace(self, treatments=(*self.treatments, treatment), **changes)

    def has_treatment(self, kind: Kind) -> bool:
        """Return whether the data had a treatment of a kind."""
        return any(treatment.kind is kind for treatment in self.treatments)

    def with_timing(self, effects: Sequence[Term] = ()) -> FitData:
        """Return the data with torque corrected by its estimated delay and filter, under a model with some effects.

        Recordings share an alignment, unless their own estimates contradict it, see `align_each`. Held-out and excluded
        recordings count, since the timing belongs to the log: `whole` is timed, and the same recordings are excluded
        again. The estimation starts from untimed data. Findings on effects and corrections replace earlier corrections.
        """
        if self.whole is not None:
            return self.whole.with_timing(effects).without_outliers(self.excluded)
        raw, terms = self.untimed or self, [term for term in self.terms if isinstance(term, Term)]
        recordings, count = raw.all_recordings, len(raw.recordings)
        alignments = align_each(recordings, [*terms, *effects])
        pairs = zip(alignments, recordings, strict=True)
        corrected = tuple(alignment.apply(recording) for alignment, recording in pairs)
        earlier = tuple(treatment for treatment in self.treatments if treatment not in self.corrections)
        changes: dict[str, Any] = {"recordings": corrected[:count], "holdout": corrected[count:], "untimed": raw}
        timed = replace(self, **changes, alignments=tuple(alignments))
        model_finding = [Finding(Kind.TIMED_BESIDE, effects=tuple(term.id for term in effects))] if effects else []
        return replace(timed, treatments=(*earlier, *model_finding, *timed.corrections))

    def without_timing(self) -> FitData:
        """Return the data with torque as logged: with no correction of its delay and filter."""
        if self.whole is not None:
            return self.whole.without_timing().without_outliers(self.excluded)
        raw, corrections = self.untimed or self, self.corrections
        others = (treatment for treatment in self.treatments if treatment not in corrections)
        earlier = tuple(treatment for treatment in others if treatment.kind is not Kind.TIMED_BESIDE)
        changes: dict[str, Any] = {"recordings": raw.recordings, "holdout": raw.holdout, "alignments": ()}
        return replace(self, **changes, treatments=(*earlier, Finding(Kind.TIMED_AS_LOGGED)))

    def without_outliers(self, outliers: Sequence[Disagreement]) -> FitData:
        """Return the data without the fitted recordings of some disagreements, and with `whole` set to these data.

        Disagreements number recordings from 1, fitted ones first; held-out ones stay. Without a fitted one, the same
        data are returned.
        """
        excluded, count = {outlier.recording for outlier in outliers}, len(self.recordings)
        remaining_numbers = [k for k in range(count) if k + 1 not in excluded]
        if len(remaining_numbers) == count:
            return self
        alignments = [
            self.alignments[k] for k in (*remaining_numbers, *range(count, len(self.alignments))) if self.alignments
        ]
        names = tuple(recording.name for k, recording in enumerate(self.recordings) if k not in remaining_numbers)
        return self.with_treatment(
            Finding(Kind.RECORDINGS_EXCLUDED, recordings=names),
            recordings=tuple(self.recordings[k] for k in remaining_numbers),
            alignments=tuple(alignments),
            excluded=tuple(outliers),
            whole=self,
        )

    def decide_conventions(self, base: Sequence[Term]) -> Self:
        """Return the data with the conventions of their drives, decided by a base model, see `decide_conventions`."""
        recordings, holdout, findings = decide_conventions(self.recordings, self.holdout, base)
        return replace(self, recordings=recordings, holdout=holdout, treatments=(*self.treatments, *findings))

    def with_changes(self, change: Callable[[Recording], Recording], numbers: Collection[int]) -> Self:
        """Return the data, also untimed, with some recordings changed, numbered from 0, fitted ones first."""
        numbered = enumerate(self.all_recordings)
        changed = tuple(change(recording) if k in numbers else recording for k, recording in numbered)
        untimed = None if self.untimed is None else self.untimed.with_changes(change, numbers)
        count = len(self.recordings)
        return replace(self, recordings=changed[:count], holdout=changed[count:], untimed=untimed)

    def with_contacts(self, terms: Sequence[Term]) -> Self:
        """Return the data with contacts with a stop, by the residual of some terms; the same data if they are few."""
        parts = add_contacts(self.parts, terms)
        if parts is self.parts:
            return self
        return self.with_treatment(Finding(Kind.IMPACTS_INCLUDED), contact_terms=tuple(terms)).with_parts(parts)

    def with_parts(self, parts: Parts) -> Self:
        """Set the cached `parts` of this object, and return it."""
        vars(self)["parts"] = parts
        return self

    def with_horizon(self, horizon: float | None) -> Self:
        """Return the data with segments of another length [s]; see `RegressionData.with_horizon`; unchanged by None."""
        if horizon is None:
            return self
        train, holdout = (part.with_horizon(horizon) for part in self.parts)
        return replace(self, horizon=horizon).with_parts((train, holdout))

    def without_history(self, terms: tuple[Term, ...] = ()) -> Self:
        """Return the data without memoised results, `whole` and `untimed`; those of an arm with `terms` instead."""
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
        parts = split_recordings(self.recordings, self.holdout, self.window_share, self.inertia)
        parts = parts if self.contact_terms is None else add_contacts(parts, self.contact_terms)
        if self.horizon is None:
            return parts
        return parts[0].with_horizon(self.horizon), parts[1].with_horizon(self.horizon)

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
        """Return whether the torque of a recording was logged late, and so corrected."""
        return any(alignment.is_late for alignment in self.alignments)

    @property
    def has_unknown_timing(self) -> bool:
        """Return whether the time between torque and motion of a recording could not be determined."""
        return any(np.isinf(alignment.delay_std) for alignment in self.alignments)

    def agrees(self, other: FitData) -> bool:
        """Return whether other data have the same alignments, within their standard errors, or these data have none."""
        return all(
            np.isinf(alignment.delay_std)
            or (alignment.is_late == counterpart.is_late and alignment.agrees(counterpart))
            for alignment, counterpart in zip(self.alignments, other.alignments, strict=True)
        )

    @property
    def conventions(self) -> tuple[Finding, ...]:
        """Findings on conventions of drives: laws of controllers, the position that they read, and course of goals."""
        controllers = [item for item in self.treatments if item.kind in (Kind.CONTROLLER_READ, Kind.COUNTS_UNSEEN)]
        positions = [item for item in self.treatments if item.kind is Kind.POSITION_READ]
        goals = [item for item in self.treatments if item.kind in (Kind.GOALS_HELD, Kind.GOALS_RUN_ON)]
        return (*controllers, *positions[-1:], *goals[-1:])  # the last decision holds

    @property
    def corrections(self) -> list[Finding]:
        """Findings on torque that was logged late and is corrected."""
        kinds = {Kind.TORQUE_LATE: Kind.TORQUE_LATE_CORRECTED, Kind.TORQUE_SAMPLED: Kind.TORQUE_SAMPLED_CORRECTED}
        return [replace(finding, kind=kinds[finding.kind]) for finding in self.find_timing(True)]

    def find_timing(self, is_late: bool) -> tuple[Finding, ...]:
        """Return findings on torque that is logged late if `is_late`, else on torque that acts late.

        Findings name their recordings, unless all recordings share one alignment.
        """
        findings, names = list[Finding](), list[list[str]]()
        for recording, alignment in zip(self.all_recordings, self.alignments, strict=bool(self.alignments)):
            if alignment.is_late != is_late or (finding := alignment.finding) is None:
                continue
            if finding not in findings:
                findings.append(finding)
                names.append([])
            names[findings.index(finding)].append(recording.name)
        if all(alignment is self.alignments[0] for alignment in self.alignments):
            return tuple(findings)
        pairs = zip(findings, names, strict=True)
        return tuple(replace(finding, recordings=tuple(own_names)) for finding, own_names in pairs)
