"""Errors of measured motion of servos by the encoder and by the clock."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.signals.differentiation import estimate_encoder_noise
from pendulum_env.recording import Recording
from robots.servos.drive import LONGEST_DELAY
from robots.servos.in_loop.counts import find_least_change
from robots.servos.in_loop.settings import LOOP
from robots.servos.torque import find_drive

Recordings = tuple[Recording, ...]


@dataclass(frozen=True)
class MotionNoise:
    """Errors of positions that no model causes.

    Attributes:
        recordings: of servos.
        motion: standard deviation of the compared positions [rad].
    """

    recordings: Recordings
    motion: float

    @cached_property
    def resolution(self) -> float:
        """Standard deviation of the quantisation by the finest encoder [rad]."""
        least = find_least_change(self.recordings)
        return least / np.sqrt(12.0) if np.isfinite(least) else LOOP.encoder.finest

    @property
    def encoder_error(self) -> float:
        """Mean absolute error due to the encoder alone [rad]."""
        noise = np.mean([estimate_encoder_noise(recording) for recording in self.recordings])
        return float(np.sqrt(2 / np.pi) * noise)

    @property
    def precision(self) -> float:
        """Error of the simulation itself [rad]."""
        return LOOP.simulation.precision * self.motion

    @cached_property
    def floor(self) -> float:
        """Error due to encoder and clock alone, the geometric mean over recordings [rad]."""
        late = [LOOP.simulation.jitter * np.std(np.gradient(r.position, r.time)) / r.rate for r in self.recordings]
        return max(self.precision, float(np.exp(np.mean(np.log(np.hypot(self.resolution, late))))))


def mistime_recordings(recordings: Recordings) -> tuple[Recordings, Recordings]:
    """Return the recordings with goals delayed by the error of the clock, and those with delayed controllers.

    A controller at the longest delay is advanced instead.
    """

    def delay_goal(recording: Recording) -> Recording:
        assert recording.reference is not None  # every rollout has a goal and a drive
        time, delay = recording.time, LOOP.simulation.jitter / recording.rate
        return replace(recording, reference=np.interp(time - delay, time, recording.reference))

    def delay_drive(recording: Recording) -> Recording:
        drive = find_drive(recording)
        now, delay = drive.delay, LOOP.simulation.jitter / recording.rate
        later = now + delay if now + delay <= LONGEST_DELAY else now - delay
        return replace(recording, drive=replace(drive, delay=later))

    return tuple(map(delay_goal, recordings)), tuple(map(delay_drive, recordings))
