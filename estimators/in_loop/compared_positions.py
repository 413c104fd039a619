"""Measured positions that simulations of servos are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from estimators.decisions.criterion import ResidualStructure
from estimators.in_loop.settings import LOOP
from estimators.weak_form.windows import Part
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.recording import Recording


def choose_grain(recordings: Sequence[Recording]) -> float:
    """Return the time between compared positions [s]: some samples of the log, or `grain` if the rates differ.

    Held goals bend the motion, so positions between samples are not known.
    """
    setting, periods = LOOP.simulation, [1.0 / recording.rate for recording in recordings]
    period = float(np.median(periods))
    is_same = max(periods) <= (1.0 + setting.same_rate) * min(periods)
    return period * max(1, round(setting.grain / period)) if is_same else setting.grain


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
    def segments(self) -> list[tuple[int, Recording]]:
        """Segments without gaps, each with the index of its recording."""
        return [(k, part) for k, recording in enumerate(self.recordings) for part in recording.segments]

    @cached_property
    def times_from_start(self) -> list[Array]:
        """Times a grain apart, from the start of each segment [s]."""
        lengths = [(part.time[-1] - part.time[0]) / self.grain for _, part in self.segments]
        return [self.grain * np.arange(1.0, int(length + 1e-6) + 1) for length in lengths]

    @cached_property
    def _compared(self) -> list[Mask]:
        """Masks of the times of each segment within the compared share of its recording."""
        masks = []
        for times, (k, part) in zip(self.times_from_start, self.segments, strict=True):
            whole = self.recordings[k]
            share = (part.time[0] - whole.time[0] + times) / (whole.time[-1] - whole.time[0] + self.grain)
            masks.append((share >= self.shares[0]) & (share < self.shares[1]))
        return masks

    @cached_property
    def measured(self) -> Array:
        """Measured positions (R,) [rad], by a cubic spline; linear interpolation is too inaccurate."""
        parts = zip(self.times_from_start, self._compared, self.segments, strict=True)
        return np.concatenate(
            [
                scipy.interpolate.CubicSpline(part.time, part.position)(part.time[0] + times[mask])
                for times, mask, (_, part) in parts
            ]
        )

    @cached_property
    def time(self) -> Array:
        """Times from the start of each recording (R,) [s]."""
        parts = zip(self.times_from_start, self._compared, self.segments, strict=True)
        return np.concatenate(
            [part.time[0] + times[mask] - self.recordings[k].time[0] for times, mask, (k, part) in parts]
        )

    @cached_property
    def recording_of(self) -> Index:
        """Index of the recording of each position (R,)."""
        return np.repeat([k for k, _ in self.segments], [int(mask.sum()) for mask in self._compared])

    def compare_paths(self, paths: Array) -> Array:
        """Return simulated positions (N + 1, V, B), a grain apart from the start, minus measured ones (R, V) [rad]."""
        simulated = np.concatenate(
            [paths[1 : len(mask) + 1, :, lane][mask] for lane, mask in enumerate(self._compared)]
        )
        farthest = LOOP.simulation.farthest
        return np.clip(np.nan_to_num(simulated, nan=np.inf) - self.measured[:, None], -farthest, farthest)

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
        is off for seconds. The geometric mean limits the weight of one recording.
        """
        squares = np.bincount(self.recording_of, residual**2) / np.bincount(self.recording_of)
        rms = float(np.exp(0.5 * np.mean(np.log(np.maximum(squares, 1e-300)))))
        return ResidualStructure(rms, 0.0, rms)
