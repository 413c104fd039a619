"""Data of a fit: recordings with torque in N m and in time, split, and cut into windows and segments; each once.

`diagnose`, `compare`, `add`, `fit`, `identify`, the report and the app all stand on what is made here.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from estimators.checks.alignment import Alignment
from estimators.checks.channel import align_each
from estimators.checks.torque_constant import torque_constant, unit_of, unknown_constant
from estimators.data.regression_data import RegressionData, with_impacts
from estimators.findings import Finding, Kind
from estimators.free_swings import fitted_inertia, known_values, scale_swings, swing
from estimators.regression.equations import IdentificationError
from estimators.selection.criterion import Criterion
from estimators.weak_form.torque_windows import choose_half_width, prepare
from pendulum_env.arms.body import Body
from pendulum_env.arms.joints import body_of
from pendulum_env.physics import Term
from pendulum_env.recording import Recording
from pendulum_env.recording.record import NEWTON_METRE, PER_INERTIA, TorqueConstant
from pendulum_env.settings import Blank, setting

HELD_OUT = 0.3  # end of each recording that is held out when no recording is
MOTION = 0.5  # of the motion, that has to come before what is held out of the end of recordings
SHORTEST = 0.25  # share of the windows' length, the least, where longer windows are too few

Parts = tuple[RegressionData, RegressionData]  # fitted and held out


@dataclass(frozen=True, eq=False)
class FitData:
    """Recordings as models are fitted to them, and what was done to them; each step makes another one.

    Attributes:
        recordings: to fit; in N m where their known loads tell the torque constant, else in the unit of the log.
        holdout: to check on; if there are none, the end of each recording to fit is.
        doubt: why the torque constant is unknown; None if it is known, or torque was logged.
        alignments: time between torque and motion in each recording, fitted ones first; torque that was logged late or
            filtered is corrected by it. Empty before anybody looked.
        window_share: length of the windows, relative to the length that the noise asks for.
        impacts_beside: terms beside which turns that miss torque are among the windows; None where they are not.
        terms: of an arm, that may be fitted to it, the links first.
    """

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...] = ()
    doubt: Finding | None = None
    alignments: tuple[Alignment, ...] = ()
    window_share: float = 1.0
    impacts_beside: tuple[Term, ...] | None = None
    terms: tuple[type[Term] | Term, ...] = ()

    @classmethod
    def of(
        cls,
        recordings: Sequence[Recording],
        holdout: Sequence[Recording] = (),
        terms: Sequence[Term | type[Term]] = (),
        *,
        constant: TorqueConstant | None = None,
        known: Mapping[str, float] | None = None,
    ) -> Self:
        """Recordings in N m: by a torque constant that is known, or else that the known loads of the fitted ones tell.

        Torque that is logged a little late is no hindrance: to first order, what comes of it is odd in the velocity.
        Free swings alone are in N m if a parameter is known, or else relative to the inertia. Currents of an arm, and
        of a controller whose integral is no part of the torque, stay as they are.

        Args:
            recordings: to fit.
            holdout: to check on.
            terms: of the base model; of an arm all that may be fitted, the links first.
            constant: the torque constant, if it is known.
            known: values of known parameters by name, which scale free swings; by default those of the terms.

        Raises:
            IdentificationError: if units differ, from that of the constant, too, or if the recordings hold too little
                motion to tell anything, or if torque is applied in held-out recordings only and no parameter is known.
        """
        every = (*recordings, *holdout)
        if isinstance(body_of(terms), Body):
            return cls(tuple(recordings), tuple(holdout), terms=tuple(terms))
        if any(own.drive is not None and own.drive.ki and own.torque_unit != NEWTON_METRE for own in every):
            doubt = unknown_constant(Kind.INTEGRAL_CONTROLLER, recordings[0].torque_unit)
            return cls(tuple(recordings), tuple(holdout), doubt)
        known = known_values([term for term in terms if isinstance(term, Term)]) if known is None else known
        driven = [own for own in every if not own.is_free]
        if len(driven) == len(every):
            return cls._in_newton_metres(recordings, holdout, constant)
        if all(own.is_free for own in recordings):
            return cls._of_swings(recordings, holdout, driven, known)
        fitted, unseen = (_swings(part, 0.0, unit_of(driven)) for part in (recordings, holdout))
        given = cls._in_newton_metres(fitted, unseen, constant)
        inertia = known.get("inertia") or fitted_inertia([own for own in given.recordings if not own.is_free])
        fitted, unseen = (_swings(part, inertia, given.unit) for part in (given.recordings, given.holdout))
        return replace(given, recordings=fitted, holdout=unseen)

    @classmethod
    def _of_swings(
        cls,
        recordings: Sequence[Recording],
        holdout: Sequence[Recording],
        driven: Sequence[Recording],
        known: Mapping[str, float],
    ) -> Self:
        """Free swings, as `of` scales them; some held-out recordings may be driven."""
        inertia = scale_swings(recordings, known)
        unit = PER_INERTIA if inertia is None else NEWTON_METRE
        if driven and unit_of(driven) != unit:
            raise IdentificationError(
                f"{driven[0].name}: has torque, but no recording that is fitted has any: fit one with torque, or give "
                f"the inertia, {setting('fixed', {'inertia': Blank('VALUE')})}, and torque in N m"
            )
        fitted, unseen = (_swings(part, 1.0 if inertia is None else inertia, unit) for part in (recordings, holdout))
        if inertia is not None:
            return cls(fitted, unseen)
        loaded = tuple(own.name for own in recordings if own.load is not None)
        return cls(fitted, unseen, Finding(Kind.RELATIVE_TO_INERTIA, recordings=loaded))

    @classmethod
    def _in_newton_metres(
        cls, recordings: Sequence[Recording], holdout: Sequence[Recording], constant: TorqueConstant | None
    ) -> Self:
        """Recordings, as `of` makes them, whose unit of torque is one."""
        unit = unit_of((*recordings, *holdout))
        if unit == NEWTON_METRE:
            return cls(tuple(recordings), tuple(holdout))
        if constant is not None and constant.of != unit:
            raise IdentificationError(
                f"torque is in {unit}, but the torque constant is of {constant.of}: convert the log"
            )
        found = constant or torque_constant(recordings)
        if isinstance(found, Finding):
            return cls(tuple(recordings), tuple(holdout), found)
        fitted, unseen = (tuple(_turned(one, found) for one in part) for part in (recordings, holdout))
        return cls(fitted, unseen)

    def timed(self, beside: Sequence[Term] = ()) -> Self:
        """The same with the torque that acted, beside effects that joints have: see `estimators.align`.

        The log's timing is no part of the model, so that held-out recordings tell it, too.
        """
        beside = [*(term for term in self.terms if isinstance(term, Term)), *beside]
        every = (*self.recordings, *self.holdout)
        alignments = align_each(every, beside)
        moved = tuple(one.apply(recording) for one, recording in zip(alignments, every, strict=True))
        count = len(self.recordings)
        return replace(self, recordings=moved[:count], holdout=moved[count:], alignments=tuple(alignments))

    def without(self, odd: Container[int]) -> Self:
        """The same without fitted recordings of the given numbers, counted from 1."""
        count = len(self.recordings)
        kept = [k for k in range(count) if k + 1 not in odd]
        if len(kept) == count:
            return self
        alignments = [self.alignments[k] for k in (*kept, *range(count, len(self.alignments))) if self.alignments]
        return replace(self, recordings=tuple(self.recordings[k] for k in kept), alignments=tuple(alignments))

    def closer(self, share: float = Criterion.shorter_window) -> Self:
        """The same in shorter windows."""
        return replace(self, window_share=share)

    def with_impacts(self, terms: Sequence[Term]) -> Self:
        """The same with the turns that miss torque beside some terms, as it is where these are too few."""
        parts = with_impacts(self.parts, terms)
        return self if parts is self.parts else replace(self, impacts_beside=tuple(terms)).holding(parts)

    def holding(self, parts: Parts) -> Self:
        """The same with parts that are prepared already."""
        vars(self)["parts"] = parts  # where the property would keep them
        return self

    def fresh(self, terms: tuple[Term, ...] = ()) -> Self:
        """The same, of an arm for given terms, without what a search has kept with the parts: columns that it tried."""
        train, holdout = map(replace, self.parts)
        return replace(self, terms=terms).holding((train, holdout))

    @cached_property
    def parts(self) -> Parts:
        """Fitted and held-out data as windows and segments.

        Raises:
            IdentificationError: if a part holds too little motion, or torque is never applied.
        """
        if self.terms:
            train, holdout = parted(self.recordings, self.holdout)
            return RegressionData.of_arm(train, self.terms), RegressionData.of_arm(holdout, self.terms)
        parts = gather(self.recordings, self.holdout, self.window_share)
        return parts if self.impacts_beside is None else with_impacts(parts, self.impacts_beside)

    def __getstate__(self) -> dict[str, Any]:
        """All but the parts, which are large, and are made again where they are needed."""
        return {name: value for name, value in vars(self).items() if name != "parts"}

    @property
    def constant(self) -> TorqueConstant | None:
        """By which currents were turned into torque; None if they were not."""
        return self.recordings[0].torque_constant

    @property
    def unit(self) -> str:
        """Of the torque: `N m`, or that of what was logged."""
        return self.recordings[0].torque_unit

    @property
    def has_moved(self) -> bool:
        """Whether any torque was corrected."""
        return any(one.is_late for one in self.alignments)

    def agrees(self, other: FitData) -> bool:
        """Whether torque is corrected alike in another's recordings, as far as both know."""
        return all(
            np.isinf(one.delay_std + two.delay_std) or (one.is_late == two.is_late and one.agrees(two))
            for one, two in zip(self.alignments, other.alignments, strict=True)
        )

    def timing(self, is_late: bool) -> tuple[Finding, ...]:
        """Findings on torque that is logged late, or that acts late; with names of recordings where they differ."""
        every = zip((*self.recordings, *self.holdout), self.alignments, strict=bool(self.alignments))
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


def _swings(recordings: Sequence[Recording], inertia: float, torque_unit: str) -> tuple[Recording, ...]:
    """Recordings with the free swings among them scaled by an inertia."""
    return tuple(swing(recording, inertia, torque_unit) for recording in recordings)


def _turned(recording: Recording, constant: TorqueConstant) -> Recording:
    """A recording in N m, whose drive has the constant for a gain."""
    torque, drive = constant.value * recording.torque, recording.drive
    if drive is not None and drive.unit == constant.of:
        drive = replace(drive, gain=constant.value)
    return replace(recording, torque=torque, torque_unit=NEWTON_METRE, torque_constant=constant, drive=drive)


def parted(
    recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
) -> tuple[list[Recording], list[Recording]]:
    """What is fitted of an arm and what is held out: the last 30 % of each recording, where no others are."""
    if holdout:
        return list(recordings), list(holdout)
    pairs = [recording.split(1 - HELD_OUT) for recording in recordings]
    return [first for first, _ in pairs], [last for _, last in pairs]


def gather(recordings: Sequence[Recording], holdout: Sequence[Recording] = (), shorter: float = 1.0) -> Parts:
    """Training and held-out data, prepared; without held-out recordings, the end of each recording is held out.

    Args:
        recordings: to fit.
        holdout: to check on.
        shorter: factor on the lengths of the windows, which are shorter still where they would be too few.

    Raises:
        IdentificationError: if a part holds too little motion, or torque is never applied.
    """
    if not any(recording.is_driven or recording.known_inertia for recording in recordings):
        names = ", ".join(recording.name for recording in recordings)
        raise IdentificationError(
            f"{names}: torque is never applied, so that only ratios of parameters are known: take `FitData.of`"
        )
    try:
        return _gather(recordings, holdout, shorter)
    except IdentificationError:
        if shorter <= SHORTEST:
            raise
        return gather(recordings, holdout, Criterion.shorter_window * shorter)  # more windows, each with more noise


def _gather(recordings: Sequence[Recording], holdout: Sequence[Recording], shorter: float) -> Parts:
    widths, checks = ([shorter * choose_half_width(r) for r in part] for part in (recordings, holdout))
    if holdout:
        return RegressionData.of(recordings, widths), RegressionData.of(holdout, checks)

    def split(share: float) -> Parts:
        return RegressionData.of(recordings, widths, (0.0, share)), RegressionData.of(recordings, widths, (share, 1.0))

    motion = np.concatenate([w.centers / len(w.recording) for w in prepare(recordings, widths).windows])
    if np.mean(motion < 1 - HELD_OUT) >= MOTION:
        with suppress(IdentificationError):  # the end may be at rest
            return split(1 - HELD_OUT)
    return split(float(np.quantile(motion, 1 - HELD_OUT)))  # of the motion, not of the time
