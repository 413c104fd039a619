"""Simulate a given model of a servo in the loop, from the goals of recordings alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.in_loop.goals import decide_goals
from estimators.in_loop.rollouts import FINE, Rollouts, are_driven
from estimators.selection.errors import Errors
from estimators.simulation.output_error import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


def make_rollouts(model: Model, recordings: Sequence[Recording]) -> tuple[Rollouts, Array]:
    """Return rollouts whose goals are held or run on as `decide_goals` has it, and their position errors (R,) [rad]."""
    rollouts = Rollouts(decide_goals(recordings), FINE)
    return rollouts, rollouts.position_errors([Point.of(model)])[:, 0]


def simulate_recording(model: Model, recording: Recording) -> tuple[Array, Array, Array]:
    """Return times (R,) [s], simulated and measured positions (R,) [rad] of a recording with a drive."""
    rollouts, missed = make_rollouts(model, [recording])
    return rollouts.time, rollouts.position + missed, rollouts.position


def simulate_from_goals(model: Model, recordings: Sequence[Recording]) -> list[Array]:
    """Return simulated positions (N,) [rad] of each recording of a servo; none without drives."""
    if not are_driven(recordings):
        return []
    rollouts, missed = make_rollouts(model, recordings)
    simulated, paths = rollouts.position + missed, []
    for k, recording in enumerate(recordings):
        own, path = rollouts.recording_of == k, []
        for part in recording.segments:
            time = part.time - recording.time[0]
            within = own & (rollouts.time > time[0]) & (rollouts.time <= time[-1])
            known = np.r_[time[0], rollouts.time[within]], np.r_[part.position[0], simulated[within]]
            path.append(np.interp(time, *known, right=np.nan))
        paths.append(np.concatenate(path))
    return paths


def add_loop_errors(model: Model, recordings: Sequence[Recording], errors: Errors) -> Errors:
    """Return the errors of a model with those in the loop, if the recordings have drives."""
    if not are_driven(recordings):
        return errors
    return errors.with_loop(make_rollouts(model, recordings)[1])
