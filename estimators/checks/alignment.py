"""Timing of torque against motion, which is checked before effects are searched.

Many logs hold torque late: it was read after the position, came over a slow bus, or passed a filter. No effect can do
that, since none acts before its cause; but several effects together can hide it, so that it has to be found first.

With tau the torque that acts and u the one that is logged, held from its sample to the next, the laws of the torque
channel, fitted by `channel`, are

    tau(t) = u(t + delay)                    delay > 0: logged late; delay < 0: it acts late, as after a dead time
    tau = u + lag u'                         lag > 0: logged through a low-pass filter
    tau + |lag| tau' = u                     lag < 0: it acts through one, as after the lag of a drive

or torque was sampled from one that went on changing until the next sample, as in a log that keeps every tenth sample of
a controller: that is half a sample late.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.special import ndtri

from estimators.findings import Finding, Kind, Quantity
from estimators.selection.criterion import Criterion
from estimators.signals.channel import Channel
from estimators.signals.differentiation import estimate_white_noise
from pendulum_env._typing import JSON, Array
from pendulum_env.recording import MovedTorque, Note, NoteKind, Recording


@dataclass(frozen=True)
class ChannelSettings:
    """Settings of the search for delays and lags, and limits of their report."""

    reach: float = 0.05  # [s], largest delay and lag of a search
    starts: int = 51  # number of delays; a search starts from the best
    sure: float = 4.0  # standard errors of a significant estimate
    clearer: float = float(ndtri(1 - Criterion().p_value))  # standard errors of a significant gain, as of an effect's
    p_value: float = Criterion.p_value  # below which more columns explain more
    by_chance: float = float(np.log(2 * reach / 1e-3))  # [nat], gained by chance by the best of so many delays
    error_margin: float = Criterion.error_margin  # share by which errors differ by chance
    kept_inertia: float = Criterion.kept_inertia  # share of it that a delay leaves by which torque acts late
    fewest_equations: int = 3  # equations for each column
    friction: tuple[float, ...] = (0.02, 0.1, 0.5)  # of the highest velocity: where friction, too, may bend
    orders: int = 48  # of sines of the angle, where torque of another kind is left
    bends: int = 3  # times that the torque of the model is refitted with columns that depend on it
    nearby: float = 1e-4  # [s], difference for derivatives
    negligible: float = 0.1  # of a sample: clocks, and the steps of simulators, are not more exact
    least_sampled: float = 0.25  # of a sample, apparent delay of torque that a controller sets twice a sample
    between: int = 4  # least number of recordings for a standard error from their scatter
    fewest_stretches: int = 3  # least number for an error from their scatter


SEARCH = ChannelSettings()


@dataclass(frozen=True)
class Alignment:
    """A law of the torque channel as fitted: the time between torque and motion.

    Attributes:
        channel: the law; neither delay nor lag if torque and motion are not apart.
        delay_std, lag_std: standard errors of its delay and lag [s], zero of what is not free.
        rival: the other of delay and filter, where it explains as much.
        is_half_sample: whether torque was sampled with the position: half a sample late, for any sampling period. The
            standard error is that of a free delay.
        gain: parameter of the first column, and its standard error.
        density: log predictive density of each stretch (2, C) [nat], if what is left acts as torque, and if it is
            noise of the log, which the channel's filter raises.
    """

    channel: Channel
    delay_std: float
    lag_std: float
    rival: Channel | None = None
    is_half_sample: bool = False
    gain: tuple[float, float] = field(default=(0.0, 0.0), compare=False, repr=False)
    density: Array = field(default_factory=lambda: np.zeros((2, 0)), compare=False, repr=False)

    @property
    def delay(self) -> float:
        """By which torque is logged late [s]; below zero it acts late."""
        return self.channel.delay

    @property
    def lag(self) -> float:
        """Time constant of the filter in the logged torque [s]; below zero, of the drive."""
        return self.channel.lag

    @property
    def is_found(self) -> bool:
        """Return whether torque and motion are shifted in time."""
        return self.channel != Channel()

    @property
    def is_late(self) -> bool:
        """Return whether torque is logged late or filtered, which no physical effect imitates."""
        return self.channel.is_late

    def beats(self, other: Alignment, by_chance: float = 0.0) -> bool:
        """Return whether it predicts significantly better, by the scatter between clusters of time.

        A channel always acts: a better fit of a single event is not a delay.
        """
        gain = self.density - other.density
        if gain.shape[1] < SEARCH.fewest_stretches:
            return False
        spread = np.sqrt(gain.shape[1]) * gain.std(axis=1)
        return bool((gain.sum(axis=1) - by_chance > SEARCH.clearer * spread).all())

    def predicts_better(self, other: Alignment) -> bool:
        """Return whether it predicts better, significantly or not."""
        return bool((self.density.sum(axis=1) > other.density.sum(axis=1)).all())

    @property
    def is_significant(self) -> bool:
        """Return whether each parameter differs significantly from zero, and lies inside the search range."""
        pairs = ((self.delay, self.delay_std), (self.lag, self.lag_std))
        return all(SEARCH.sure * std < abs(value) < SEARCH.reach for value, std in pairs if std > 0)

    def is_supported(self, none: Alignment) -> bool:
        """Return whether it predicts significantly better than no shift, with significant parameters."""
        return self.is_significant and self.beats(none, SEARCH.by_chance)

    def agrees(self, other: Alignment) -> bool:
        """Return whether delay and lag agree with those of another alignment within their errors."""
        if self.is_half_sample and other.is_half_sample:  # each of its own period
            return True
        difference = self.delay + self.lag - other.delay - other.lag
        std = np.hypot(self.delay_std + self.lag_std, other.delay_std + other.lag_std)
        return bool(abs(difference) <= SEARCH.sure * std)

    def apply(self, recording: Recording, later: float = 0.0, slower: float = 0.0) -> Recording:
        """Correct the torque of a recording that was logged late or filtered; return other recordings unchanged.

        The last samples of each segment have no logged torque and are omitted. `later` and `slower` are added to the
        delay and to the lag [s]; the remaining samples are the same for any values of these.
        """
        if not self.is_late:
            return recording
        period = 1.0 / recording.rate
        channel = replace(self.channel, delay=0.5 * period) if self.is_half_sample else self.channel
        changed = replace(channel, delay=channel.delay + later, lag=channel.lag + slower)
        edge = 2 * self.channel.is_sampled  # samples without neighbours for a cubic
        first = max(edge, int(self.lag > 0))
        beyond = int(np.ceil(max(channel.delay, 0.0) / period - 1e-9)) + edge
        kept_rows, torque = [], []
        joints = recording.torque.reshape(len(recording), -1).T  # of an arm several
        for begin, end in pairwise((*recording.starts, len(recording))):
            if end - beyond - begin - first >= 2:
                acting = np.column_stack([changed.hold_torque(own[begin:end], period) for own in joints])
                kept_rows.append(np.arange(begin + first, end - beyond))
                torque.append(acting[first : end - beyond - begin])
        if not kept_rows:
            return recording
        rows, shape = np.concatenate(kept_rows), (-1, *recording.torque.shape[1:])
        own: dict[str, Any] = {quantity: values[rows] for quantity, values in recording.series.items()}
        own |= {"torque": np.concatenate(torque).reshape(shape)}
        if recording.torque.ndim == 1:
            reach = beyond + edge + int(np.ceil(5 * max(channel.lag, 0.0) / period))
            response = channel.hold_torque(np.eye(1, 2 * reach + 1, reach)[0], period)
            is_sampled = self.channel.is_sampled or self.is_half_sample
            own["moved"] = MovedTorque(estimate_white_noise(recording.torque), response, is_sampled)
        starts = tuple(np.cumsum([0, *map(len, kept_rows[:-1])]).tolist())
        return replace(recording, **own, starts=starts, notes=(*recording.notes, self._note))

    @property
    def _note(self) -> Note:
        """Note the parts of the law that was corrected; half a sample has none."""
        parts = {} if self.is_half_sample else {"delay": self.delay, "lag": self.lag}
        return Note(NoteKind.ALIGNED, numbers={name: Quantity(size, unit="s") for name, size in parts.items() if size})

    @property
    def finding(self) -> Finding | None:
        """Finding on the timing; None if torque and motion are in time. Sampled torque may have no delay of its own."""
        if not self.is_found:
            return None
        numbers = (
            {"delay": Quantity(abs(self.delay), self.delay_std, "s")} if self.delay and not self.is_half_sample else {}
        )
        numbers |= {"lag": Quantity(abs(self.lag), self.lag_std, "s")} if self.lag else {}
        if self.rival is not None:
            law = "rival_delay" if self.rival.delay else "rival_lag"
            numbers[law] = Quantity(abs(self.rival.delay or self.rival.lag), unit="s")
        if not self.is_late:
            return Finding(Kind.ACTS_LATE, numbers)
        return Finding(Kind.TORQUE_SAMPLED if self.channel.is_sampled else Kind.TORQUE_LATE, numbers)

    def json(self) -> JSON:
        """Return delay and lag as a dictionary for JSON.

        A positive delay is a late log, a negative delay a late action. A negative lag is of the drive. An unknown
        standard error is null.
        """
        errors = [std if np.isfinite(std) else None for std in (self.delay_std, self.lag_std)]
        return {
            "delay": {"value": self.delay, "std": errors[0], "unit": "s"},
            "lag": {"value": self.lag, "std": errors[1], "unit": "s"},
            "sampled": self.channel.is_sampled,
        }


NO_ALIGNMENT = Alignment(Channel(), np.inf, np.inf)  # of recordings that are too short
