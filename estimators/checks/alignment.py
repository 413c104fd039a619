"""Whether torque stands beside the motion that it drives, before anybody asks what drives the motion.

Many logs hold torque late: it was read after the position, came over a slow bus, or passed a filter. No effect can do
that, since none acts before its cause; but several effects together can hide it, so that it has to be found first.

With tau the torque that acts and u the one that is logged, held from its sample to the next, the laws of the torque
channel (`channel_fits`) are

    tau(t) = u(t + delay)                    delay > 0: logged late; delay < 0: it acts late, as after a dead time
    tau = u + lag u'                         lag > 0: logged through a low-pass filter
    tau + |lag| tau' = u                     lag < 0: it acts through one, as after the lag of a drive

or torque was sampled from one that went on changing until the next sample, as in a log that keeps every tenth sample of
a controller: that is half a sample late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from estimators.checks.channel_fits import SEARCH, ChannelFits, Law
from estimators.regression.equations import IdentificationError
from estimators.signals.channel import Channel
from pendulum_env._typing import JSON
from pendulum_env.physics import Term
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class Alignment:
    """What was found of the time between torque and motion.

    Attributes:
        channel: the law of the torque channel; neither delay nor lag if torque and motion are not apart.
        delay_std, lag_std: standard errors of its delay and lag [s].
        rival: the other of delay and filter in words, where it explains as much.
    """

    channel: Channel
    delay_std: float
    lag_std: float
    rival: str | None = None

    @property
    def delay(self) -> float:
        """By which torque is logged late [s]; below zero it acts late."""
        return self.channel.delay

    @property
    def lag(self) -> float:
        """Time constant of the filter in the logged torque [s]; below zero, of the drive."""
        return self.channel.lag

    def json(self) -> JSON:
        """Plain dictionary for JSON; a standard error that is not known is null."""
        errors = [std if np.isfinite(std) else None for std in (self.delay_std, self.lag_std)]
        return {
            "delay": {"value": self.delay, "std": errors[0], "unit": "s"},
            "lag": {"value": self.lag, "std": errors[1], "unit": "s"},
            "sampled": self.channel.is_sampled,
            "text": self.text,
        }

    @property
    def is_found(self) -> bool:
        """Whether torque and motion are apart in time."""
        return self.channel != Channel()

    @property
    def is_late(self) -> bool:
        """Whether torque is logged late or filtered, which no physical effect can do."""
        return self.channel.is_late

    @property
    def text(self) -> str | None:
        """What was found, in a sentence; None if nothing was."""
        if not self.is_found:
            return None
        delay, lag = _estimate(abs(self.delay), self.delay_std), _estimate(abs(self.lag), self.lag_std)
        either = f" (or {self.rival}: only steps of torque would tell)" if self.rival else ""
        if self.is_late:
            found = [
                *([f"logged {delay} late"] if self.delay else []),
                *([f"logged through a low-pass filter with a time constant of {lag}"] if self.lag else []),
            ]
            kind = ": it was sampled like the position and not held until the next sample, as where rows are left out"
            return f"torque is {' and '.join(found)}{kind if self.channel.is_sampled else ''}{either}"
        after = f"{delay} after it is logged, not counting the half sample that holding it takes"
        law = f"to act {after}" if self.delay else f"to act with a lag of {lag}"
        return (
            f"torque seems {law}{either}: the drive does that (dead_time, actuator_lag), or the log is ahead of the "
            "position, which is the same law; or the joint yields, or its law is another; current or torque measured "
            "at the motor would tell"
        )

    def agrees(self, other: Alignment) -> bool:
        """Whether it is no other delay and lag than another's, as far as both are known."""
        apart = self.delay + self.lag - other.delay - other.lag
        spread = np.hypot(self.delay_std + self.lag_std, other.delay_std + other.lag_std)
        return bool(abs(apart) <= SEARCH.sure * spread)

    def apply(self, recording: Recording) -> Recording:
        """The recording with the torque that acted, where it was logged late or filtered; else as it is.

        The last samples of each segment, whose torque was never logged, are left out.
        """
        if not self.is_late:
            return recording
        period = 1.0 / recording.rate
        edge = 2 * self.channel.is_sampled  # samples whose cubic has no neighbours
        first = max(edge, int(self.lag > 0))
        beyond = int(np.ceil(max(self.delay, 0.0) / period - 1e-9)) + edge
        kept, torque = [], []
        for begin, end in pairwise((*recording.starts, len(recording))):
            if end - beyond - begin - first >= 2:
                acting = self.channel.held(recording.torque[begin:end], period)
                kept.append(np.arange(begin + first, end - beyond))
                torque.append(acting[first : end - beyond - begin])
        if not kept:
            return recording
        own: dict[str, Any] = {name: values[np.concatenate(kept)] for name, values in recording.columns.items()}
        own["torque"] = np.concatenate(torque)
        return replace(
            recording,
            **own,
            starts=tuple(np.cumsum([0, *map(len, kept[:-1])]).tolist()),
            notes=(*recording.notes, f"aligned: {self.text}"),
        )


def align(recordings: Sequence[Recording], beside: Sequence[Term] = ()) -> Alignment:
    """Delay and lag of the torque channel that all recordings share.

    Args:
        recordings: one or more.
        beside: effects that the joint has, with their shape parameters set; those that depend on the motion alone,
            and on what it was before, are fitted along.

    A law is reported if its delay or lag is `SEARCH.sure` standard errors from none, and if it surely predicts better
    seconds to which it was not fitted. A filter is told from a delay where it surely predicts better, else both are
    said. What looks logged late by half a sample, or by less since a controller held it for a while, was sampled unless
    held torque surely predicts better; what looks late by more was, if that surely predicts better.
    Recordings too short to tell give an alignment without a finding and with infinite standard errors.
    """
    try:
        if not any(recording.torque.any() for recording in recordings):
            raise IdentificationError("torque is never applied")
        fits = ChannelFits.of(recordings, beside)
    except IdentificationError:
        fits = None
    if fits is None:
        return Alignment(Channel(), np.inf, np.inf)
    found, law = _found(fits)
    if not found.is_late:
        return found
    other, rival = _found(replace(fits, is_sampled=True))
    is_usual = found.delay + found.lag < 0.5 * fits.period + SEARCH.sure * (found.delay_std + found.lag_std)
    is_sampled = not law.excels(rival) if is_usual else rival.excels(law)
    return replace(other, rival=None) if is_sampled and other.is_late else found


def align_each(recordings: Sequence[Recording], beside: Sequence[Term] = ()) -> list[Alignment]:
    """One alignment for all recordings, or each its own where they differ; see `align`."""
    joint = align(recordings, beside)
    if len(recordings) == 1:
        return [joint]
    each = [align([recording], beside) for recording in recordings]
    alone = [one if one.is_late or not one.is_found else joint for one in each]  # all have the same drive
    shared = joint.is_found or not any(one.is_found for one in alone)
    return [joint] * len(alone) if shared and all(one.agrees(joint) for one in alone) else alone


@dataclass(frozen=True)
class Aligned:
    """Recordings with the torque that acted, each as it is where its torque was logged in time.

    Attributes:
        recordings: fitted ones.
        holdout: held-out ones: aligned like the fitted ones, or each by itself where those differ.
        alignments: what was found in each, fitted ones first.
    """

    recordings: tuple[Recording, ...]
    holdout: tuple[Recording, ...]
    alignments: tuple[Alignment, ...]

    @classmethod
    def of(
        cls, recordings: Sequence[Recording], holdout: Sequence[Recording] = (), beside: Sequence[Term] = ()
    ) -> Aligned:
        """Recordings aligned; those that were are not touched again. See `align` for what else is known."""
        fitted = align_each(recordings, beside)
        alike = all(one is fitted[0] for one in fitted)
        return cls.by(
            (*fitted, *(fitted[:1] * len(holdout) if alike else align_each(holdout, beside))), recordings, holdout
        )

    @classmethod
    def by(
        cls, alignments: Sequence[Alignment], recordings: Sequence[Recording], holdout: Sequence[Recording] = ()
    ) -> Aligned:
        """Recordings under alignments that are known."""
        every = [*recordings, *holdout]
        moved = tuple(one.apply(recording) for one, recording in zip(alignments, every, strict=True))
        return cls(moved[: len(recordings)], moved[len(recordings) :], tuple(alignments))

    @property
    def has_moved(self) -> bool:
        """Whether any torque was corrected."""
        return any(one.is_late for one in self.alignments)

    def agrees(self, other: Aligned) -> bool:
        """Whether torque is corrected alike in another's recordings, as far as both know."""
        pairs = list(zip(self.alignments, other.alignments, strict=True))
        return all(
            np.isinf(one.delay_std + two.delay_std) or (one.is_late == two.is_late and one.agrees(two))
            for one, two in pairs
        )

    def texts(self, is_late: bool) -> tuple[str, ...]:
        """What was found of torque that is logged late, or of torque that acts late; with names where they differ."""
        every = [*self.recordings, *self.holdout]
        told = [(r.name, one.text) for r, one in zip(every, self.alignments, strict=True) if one.is_late == is_late]
        said = {text: name for name, text in told if text is not None}
        if all(one is self.alignments[0] for one in self.alignments):
            return tuple(said)
        return tuple(f"{name}: {text}" for text, name in said.items())


def _found(fits: ChannelFits) -> tuple[Alignment, Law]:
    """The alignment by the simplest law that predicts significantly better than others, and that law.

    A filter shorter than a sample cannot be distinguished from a delay by a share of it.
    """
    fits = fits.sharpest()
    none, delay, late = fits.fit([np.zeros(2)]), fits.delayed, fits.delayed.channel.delay
    lag = fits.fit([np.array([0.0, share * late]) for share in (0.5, 1.0, 1.5)], (1,))
    if not delay.stands(none) or abs(late) < SEARCH.negligible * fits.period:  # a filtered torque is late, too
        # an insignificant delay gets a wide standard error, so that it does not veto the joint estimate
        spread = max(delay.std[0], abs(late) / SEARCH.sure), max(lag.std[1], abs(lag.channel.lag) / SEARCH.sure)
        return Alignment(none.channel, *spread), none
    if late > 0:
        both = fits.fit([late * np.array([share, 1 - share]) for share in (0.25, 0.5, 0.75)], (0, 1), low=0.0)
        if both.stands(none) and both.channel.lag > fits.period and both.excels(delay) and both.excels(lag):
            return Alignment(both.channel, *both.std), both
    is_likelier = (lag.density.sum(axis=1) > delay.density.sum(axis=1)).all()
    is_filter = is_likelier and lag.stands(none) and abs(lag.channel.lag) >= fits.period
    law, other = (lag, delay) if is_filter else (delay, lag)
    rival = None if law.excels(other) or not other.stands(none) else _words(other.channel)
    return Alignment(law.channel, *law.std, rival=rival), law


def _words(channel: Channel) -> str:
    """The rival in words."""
    if channel.delay:
        return f"by a delay of {1e3 * abs(channel.delay):.3g} ms"
    law = "through a low-pass filter with a time constant" if channel.is_late else "with a lag"
    return f"{law} of {1e3 * abs(channel.lag):.3g} ms"


def _estimate(value: float, std: float) -> str:
    """Value and standard error in ms, the latter to one digit: `9.90 ± 0.04 ms`."""
    digits = min(3, max(0, -int(np.floor(np.log10(max(1e3 * std, 1e-3))))))
    return f"{1e3 * value:.{digits}f} ± {1e3 * std:.{digits}f} ms"
