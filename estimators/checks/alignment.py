"""Delay and lag between torque and motion, estimated before the search for effects.

Torque is logged late if it is read after the position, sent over a slow bus, or filtered. A single effect cannot
imitate late torque, because no effect acts before its cause. Several effects together can imitate it.

`channel` fits the laws of the torque channel. tau is the acting torque, u the logged torque, held between samples:

    tau(t) = u(t + delay)                    delay > 0: logged late; delay < 0: acts late, as after a dead time
    tau = u + lag u'                         lag > 0: logged through a low-pass filter
    tau + |lag| tau' = u                     lag < 0: acts through a low-pass filter, as after an actuator

Torque that is sampled while it changes is half a sample late. An example is every tenth sample of a controller.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimators.checks.closed_loop import find_feedback
from estimators.checks.settings import CHECKS
from estimators.decisions.criterion import Criterion
from estimators.decisions.decision import Policy, decide
from estimators.decisions.gate import Gate, limit_gain
from estimators.decisions.score import Bootstrap
from estimators.findings import Finding, Quantity
from estimators.signals.channel import LONGEST, REACH, UNMIXED_SAMPLES, Channel
from estimators.signals.differentiation import (
    estimate_encoder_noise,
    estimate_log_noise,
    estimate_noise_slope,
)
from pendulum_env._typing import JSON, Array, Index
from pendulum_env.recording import MovedTorque, Note, NoteKind, Recording


@dataclass(frozen=True)
class TorqueTiming(Finding):
    """Time between torque and motion.

    Attributes:
        is_late: whether torque is logged late, or through a filter; else it acts late.
        delay: delay; None for a filter alone, and for half a sample.
        lag: time constant of a filter; None for a delay alone.
        is_sampled: whether torque was sampled like the position, half a sample late.
        rival_lag: time constant of a filter that fits equally; else None.
        is_corrected: whether the torque was corrected.
        recordings: names of its recordings.
        joint: joint to which the law applies; empty for all joints.
    """

    is_late: bool
    delay: Quantity | None = None
    lag: Quantity | None = None
    is_sampled: bool = False
    rival_lag: Quantity | None = None
    is_corrected: bool = False
    recordings: tuple[str, ...] = ()
    joint: str = ""

    @property
    def is_biasing(self) -> bool:
        """Return whether the torque is not corrected; `identify` reports it for models without a delay."""
        return not self.is_corrected


@dataclass(frozen=True)
class Alignment:
    """Fitted law of the torque channel: the time between torque and motion.

    Attributes:
        channel: the law; without delay and lag if torque and motion are in time.
        delay_std, lag_std: standard errors of its delay and lag [s]; 0 of a fixed parameter.
        rival_lag: time constant of a filter that explains the torque as well as the delay [s]; 0 without one.
        is_half_sample: whether torque was sampled with the position, so it is half of any sampling period late. The
            standard error is that of a free delay.
        joint: joint to which the law applies; empty for all joints.
        gain: parameter of the first column, and its standard error.
        density: log predictive density of the logged torque in each block (C,) [nat].
        of_block: recording of each block (C,).
        misfit: norm of the weighted residual, with errors of smoothing and integration.
        period: sample time [s].
        criterion: limits of its comparisons with others.
    """

    channel: Channel
    delay_std: float
    lag_std: float
    rival_lag: float = 0.0
    is_half_sample: bool = False
    joint: str = ""
    gain: tuple[float, float] = field(default=(0.0, 0.0), compare=False, repr=False)
    density: Array = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)
    of_block: Index = field(default_factory=lambda: np.zeros(0, dtype=int), compare=False, repr=False)
    misfit: float = field(default=0.0, compare=False, repr=False)
    period: float = field(default=0.0, compare=False, repr=False)
    criterion: Criterion = field(default=Criterion(), compare=False, repr=False)

    @property
    def delay(self) -> float:
        """Time by which torque is logged late [s]; if negative, torque acts late."""
        return self.channel.delay

    @property
    def lag(self) -> float:
        """Time constant of the filter in the log [s]; if negative, of the actuator."""
        return self.channel.lag

    @property
    def is_found(self) -> bool:
        """Return whether torque and motion are shifted in time."""
        return bool(self.delay or self.lag)

    @property
    def is_late(self) -> bool:
        """Return whether torque is logged late or filtered, which no physical effect imitates."""
        return self.channel.is_late

    def beats(self, other: Alignment) -> bool:
        """Return whether it predicts significantly better."""
        return decide(self, other, OVERRULE).passed

    @property
    def penalty(self) -> float:
        """Return the logarithm of the number of tried values of the free parameters [nat]."""
        free = (self.delay != 0) * (not self.is_half_sample) + (self.lag != 0)
        return free * float(np.log(CHECKS.channel.candidates))

    @property
    def is_determined(self) -> bool:
        """Return whether delay and lag differ significantly from zero, and lie inside the search range."""
        z_score = self.criterion.timing.z_score
        parts = (self.delay, self.delay_std, LONGEST), (self.lag, self.lag_std, REACH)
        return all(z_score * std < abs(value) and -REACH < value < most for value, std, most in parts if value)

    def agrees(self, other: Alignment) -> bool:
        """Return whether delay plus lag agree with those of another alignment within their errors."""
        if self.is_found and other.is_found and self.joint != other.joint:
            return False
        if self.is_half_sample and other.is_half_sample:  # sampling periods may differ
            return True
        difference = self.delay + self.lag - other.delay - other.lag
        std = np.hypot(self.delay_std + self.lag_std, other.delay_std + other.lag_std)
        return bool(abs(difference) <= self.criterion.timing.z_score * std)

    def moves(self, joint: str) -> bool:
        """Return whether the torque of a joint is corrected."""
        return self.joint in ("", joint)

    def reduce_delay(self, dead_time: float, std: float) -> Alignment:
        """Return the law with a shorter delay: a dead time after a correction is the excess of its delay.

        `dead_time` and its standard error `std` are in seconds. If the dead time is longer, torque acts late.
        """
        channel = replace(self.channel, delay=self.delay - dead_time)
        return replace(self, channel=channel, delay_std=std, rival_lag=0.0, is_half_sample=False)

    def select_channel(self, period: float) -> Channel:
        """Return the law of a recording with a sample time `period` [s]."""
        return replace(self.channel, delay=0.5 * period) if self.is_half_sample else self.channel

    def apply(self, recording: Recording) -> Recording:
        """Correct the torque of a recording that was logged late or filtered; return other recordings unchanged.

        The last samples of each segment have no logged torque and are omitted.
        """
        if not self.is_late:
            return recording
        period = 1.0 / recording.rate
        channel = self.select_channel(period)
        margin = 2 * self.channel.is_sampled  # samples without neighbours for a cubic
        first = max(margin, int(self.lag > 0))
        n_omitted = int(np.ceil(max(channel.delay, 0.0) / period - 1e-9)) + margin
        kept_rows, torque = [], []
        names, joints = getattr(recording, "names", ("",)), recording.torque.reshape(len(recording), -1).T  # (J, N)
        for segment in recording.segment_slices:
            begin, end = segment.start, segment.stop
            if end - n_omitted - begin - first >= 2:
                parts = zip(names, (series[begin:end] for series in joints), strict=True)
                moved = (channel.hold_torque(own, period) if self.moves(at) else own for at, own in parts)
                acting = np.column_stack([*moved])
                kept_rows.append(np.arange(begin + first, end - n_omitted))
                torque.append(acting[first : end - n_omitted - begin])
        if not kept_rows:
            return recording
        rows, shape = np.concatenate(kept_rows), (-1, *recording.torque.shape[1:])
        series: dict[str, Any] = {quantity: values[rows] for quantity, values in recording.series.items()}
        series |= {"torque": np.concatenate(torque).reshape(shape)}
        if recording.torque.ndim == 1:
            feedback = 0 if channel.is_sampled or not channel.delay else UNMIXED_SAMPLES
            reach = n_omitted + margin + int(np.ceil(5 * max(channel.lag, 0.0) / period)) + feedback
            log, impulse = recording, np.eye(1, 2 * reach + 1, reach)[0]
            if channel.has_filtered_noise(recording.torque, period):
                unfiltered = channel.remove_filter(recording.torque, period)
                log, channel = replace(recording, torque=unfiltered), replace(channel, lag=0.0)
            is_sampled = self.channel.is_sampled or self.is_half_sample
            series["moved"] = make_moved_torque(log, channel.hold_torque(impulse, period), is_sampled, self.criterion)
        starts = tuple(np.cumsum([0, *map(len, kept_rows[:-1])]).tolist())
        return replace(recording, **series, starts=starts, notes=(*recording.notes, self._note))

    @property
    def _note(self) -> Note:
        """Make the note of the corrected delay and lag; half a sample has no numbers."""
        parts = {} if self.is_half_sample else {"delay": self.delay, "lag": self.lag}
        return Note(NoteKind.ALIGNED, numbers={name: Quantity(size, unit="s") for name, size in parts.items() if size})

    @property
    def finding(self) -> TorqueTiming | None:
        """Return the finding on the timing; None if torque and motion are in time."""
        if not self.is_found:
            return None
        return TorqueTiming(
            self.is_late,
            Quantity(abs(self.delay), self.delay_std, "s") if self.delay and not self.is_half_sample else None,
            Quantity(abs(self.lag), self.lag_std, "s") if self.lag else None,
            self.is_late and self.channel.is_sampled,
            Quantity(abs(self.rival_lag), unit="s") if self.rival_lag else None,
            joint=self.joint,
        )

    def json(self) -> JSON:
        """Return delay and lag as a dictionary for JSON, signed as in `Channel`; an unknown standard error is null."""
        return {
            "delay": Quantity(self.delay, self.delay_std, "s").json(),
            "lag": Quantity(self.lag, self.lag_std, "s").json(),
            "sampled": self.channel.is_sampled,
            "joint": self.joint,
        }


def require_gain(after: Alignment, before: Alignment) -> Iterator[Gate]:
    """Test the gain in prediction, by its scatter between blocks of time and between recordings.

    The penalty is that of the parameters, at least log(1 / p_value): a smaller gain without scatter is no evidence.
    """
    limits, has_same_windows = after.criterion, np.array_equal(after.of_block, before.of_block)
    yield Gate("same_windows", int(has_same_windows), 1, has_same_windows)
    if has_same_windows:
        penalty = max(after.penalty - before.penalty, -float(np.log(limits.p_value)))
        bootstrap = Bootstrap(after.of_block)
        yield from limit_gain(bootstrap.gain(after.density, before.density, penalty), penalty, limits.p_value)


# One law of the channel predicts significantly better than another.
OVERRULE = Policy("overrule", (require_gain,))


def make_moved_torque(recording: Recording, response: Array, is_sampled: bool, criterion: Criterion) -> MovedTorque:
    """Make the noise of the torque of a recording, before its move in time by a filter with a response (L,).

    A controller reacts to its encoder without delay. The noise is at least as large as this reaction. The slope of
    an integrated position is unknown.
    """
    has_feedback = bool(find_feedback([recording], criterion))
    is_known = has_feedback and not recording.has_integrated_position
    answer = estimate_noise_slope(recording.position, recording.torque) if is_known else 0.0
    noise = estimate_log_noise(recording.torque, recording.position)
    noise = max(noise, abs(answer) * estimate_encoder_noise(recording))
    return MovedTorque(noise, response, is_sampled, answer)


NO_ALIGNMENT = Alignment(Channel(), np.inf, np.inf)  # of recordings that are too short
