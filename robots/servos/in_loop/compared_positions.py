"""Measured positions that simulations of servos are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy

from estimators.decisions.criterion import ResidualStructure
from estimators.weak_form.windows import Part
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.recording import Recording
from robots.servos.in_loop.settings import LOOP

STILL = 0.01  # largest range of a joint at rest, relative to the largest of all recordings


def choose_grain(recordings: Sequence[Recording]) -> float:
    """Return the time between compared positions [s]: some samples of the log, or `grain` if the rates differ.

    Held goals bend the motion, so positions between samples are not known.
    """
    setting, periods = LOOP.simulation, [1.0 / recording.rate for recording in recordings]
    period = float(np.median(periods))
    is_same = max(periods) <= (1.0 + setting.same_rate) * min(periods)
    return period * max(1, round(setting.grain / period)) if is_same else setting.grain


class ComparedSegment(NamedTuple):
    """Segment of a recording without gaps.

    Attributes:
        part: the segment.
        recording: index of the recording.
        times: times a grain apart, from the start of the segment [s].
        is_compared: mask of the times within the compared part of the recording.
    """

    part: Recording
    recording: int
    times: Array
    is_compared: Mask

    @property
    def time(self) -> Array:
        """Return the compared times on the clock of the recording [s]."""
        return self.part.time[0] + self.times[self.is_compared]


@dataclass(frozen=True)
class ComparedPositions:
    """Measured positions (R,), a grain apart in each segment of some recordings.

    Attributes:
        recordings: of servos.
        shares: begin and end of the compared part of each recording.
        grain: time between compared positions [s].
    """

    recordings: tuple[Recording, ...]
    shares: Part
    grain: float

    @cached_property
    def segments(self) -> list[ComparedSegment]:
        """Segments of all recordings."""
        segments = []
        for k, whole in enumerate(self.recordings):
            for part in whole.segments:
                length, begin = (part.time[-1] - part.time[0]) / self.grain, part.time[0] - whole.time[0]
                times = self.grain * np.arange(1.0, int(length + 1e-6) + 1)
                share = (begin + times) / (whole.time[-1] - whole.time[0] + self.grain)
                is_compared = (share >= self.shares[0]) & (share < self.shares[1])
                segments.append(ComparedSegment(part, k, times, is_compared))
        return segments

    @cached_property
    def measured(self) -> Array:
        """Measured positions (R,) [rad], by a cubic spline; linear interpolation is too inaccurate."""
        splines = [scipy.interpolate.CubicSpline(part.time, part.position) for part, *_ in self.segments]
        return np.concatenate([spline(one.time) for spline, one in zip(splines, self.segments, strict=True)])

    @cached_property
    def time(self) -> Array:
        """Times from the start of each recording (R,) [s]."""
        return np.concatenate([one.time - self.recordings[one.recording].time[0] for one in self.segments])

    @cached_property
    def recording_of(self) -> Index:
        """Index of the recording of each position (R,)."""
        return np.repeat([one.recording for one in self.segments], [len(one.time) for one in self.segments])

    def compare_paths(self, paths: Array) -> Array:
        """Return simulated positions (N + 1, V, B), a grain apart from the start, minus measured ones (R, V) [rad]."""
        lanes = [paths[1 : len(one.times) + 1, :, lane][one.is_compared] for lane, one in enumerate(self.segments)]
        farthest, simulated = LOOP.simulation.farthest, np.nan_to_num(np.concatenate(lanes), nan=np.inf)
        return np.clip(simulated - self.measured[:, None], -farthest, farthest)

    @cached_property
    def clusters(self) -> Index:
        """Cluster of time of each position (R,), for standard errors."""
        return self.blocks(LOOP.simulation.correlated)[0]

    def blocks(self, length: float) -> tuple[Index, Index, Index]:
        """Return the block of `length` seconds and the recording of each row (R,); the recording of each block (S,)."""
        pairs = np.column_stack([self.recording_of, (self.time / length).astype(np.intp)])
        blocks, block = np.unique(pairs, axis=0, return_inverse=True)
        return block.ravel(), self.recording_of, blocks[:, 0]

    def measure_structure(self, residual: Array) -> ResidualStructure:
        """Return the size of a residual (R,) [rad], the geometric mean of the RMS over recordings.

        Correlated neighbours do not indicate a missing effect: a servo that sticks at another position than its model
        is off for seconds. The geometric mean limits the weight of one recording. Recordings at rest have no error and
        do not count beside others.
        """
        squares = np.bincount(self.recording_of, residual**2) / np.bincount(self.recording_of)
        spans = np.array([np.ptp(self.measured[self.recording_of == k]) for k in range(len(squares))])
        is_moving = spans > STILL * spans.max()
        squares = squares[is_moving] if is_moving.any() else squares
        rms = float(np.exp(0.5 * np.mean(np.log(np.maximum(squares, 1e-300)))))
        return ResidualStructure(rms, 0.0, rms)
