"""Simulated and measured motion of whole recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.decisions.errors import Errors
from pendulum_env._typing import Array, Index
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class WholeMotion:
    """Simulated and measured motion of whole recordings (R,); without rows, and false, if it is not simulated.

    Attributes:
        time: from the start of each recording [s].
        measured: position [rad].
        error: simulated minus measured position [rad].
        recording_of: number of the recording.
    """

    time: Array
    measured: Array
    error: Array
    recording_of: Index

    def __bool__(self) -> bool:
        return bool(len(self.error))

    @property
    def simulated_position(self) -> Array:
        """Return the simulated position (R,) [rad]."""
        return self.measured + self.error

    def extend(self, errors: Errors) -> Errors:
        """Extend errors by those of this motion, if it has rows."""
        return errors.with_motion_errors(self.error, self.measured) if self else errors

    def select_recording(self, number: int) -> WholeMotion:
        """Return the motion of one recording."""
        rows = self.recording_of == number
        return WholeMotion(self.time[rows], self.measured[rows], self.error[rows], self.recording_of[rows])

    def interpolate(self, recording: Recording) -> Array:
        """Return the simulated position at the samples (N,) of the recording of this motion [rad].

        It is NaN after the last simulated position.
        """
        path = []
        for segment in recording.segments:
            time = segment.time - recording.time[0]
            is_inside = (self.time > time[0]) & (self.time <= time[-1])
            points = (
                np.r_[time[0], self.time[is_inside]],
                np.r_[segment.position[0], self.simulated_position[is_inside]],
            )
            path.append(np.interp(time, *points, right=np.nan))
        return np.concatenate(path)


NOT_SIMULATED = WholeMotion(np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.intp))
