"""Simulate a given model of a servo in the loop, from the goals of recordings alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.in_loop.rollouts import FINE, Rollouts, are_driven
from estimators.simulation.output_error import Point
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


@dataclass(frozen=True)
class LoopMotion:
    """Simulated and measured motion of recordings (R,); without rows, and false, if no controllers are known.

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
    def simulated(self) -> Array:
        """Simulated position (R,) [rad]."""
        return self.measured + self.error

    def select_recording(self, number: int) -> LoopMotion:
        """Return the motion of one recording."""
        own = self.recording_of == number
        return LoopMotion(self.time[own], self.measured[own], self.error[own], self.recording_of[own])

    def interpolate(self, recording: Recording) -> Array:
        """Return the simulated position at the samples (N,) of the recording that this motion is of [rad]."""
        path = []
        for part in recording.segments:
            time = part.time - recording.time[0]
            within = (self.time > time[0]) & (self.time <= time[-1])
            known = np.r_[time[0], self.time[within]], np.r_[part.position[0], self.simulated[within]]
            path.append(np.interp(time, *known, right=np.nan))
        return np.concatenate(path)


def simulate_in_loop(model: Model, recordings: Sequence[Recording]) -> LoopMotion:
    """Simulate whole recordings of servos with their controllers in the loop."""
    if not are_driven(recordings):
        return LoopMotion(np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.intp))
    rollouts = Rollouts(tuple(recordings), FINE)
    error = rollouts.position_errors([Point.from_model(model)])[:, 0]
    return LoopMotion(rollouts.time, rollouts.position, error, rollouts.recording_of)
