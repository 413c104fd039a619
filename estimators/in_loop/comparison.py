"""A model of a servo against whole recordings, simulated from their goals alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.in_loop.fit import likelihood
from estimators.in_loop.rollouts import FINE, Rollouts, are_driven, with_gain
from estimators.selection.data import Errors
from estimators.simulation.output_error import Point
from pendulum_env._typing import Array
from pendulum_env.physics import Model
from pendulum_env.recording import Recording


def likelier(model: Model, recordings: Sequence[Recording]) -> tuple[Rollouts, Array]:
    """Rollouts whose goals are held, or run on, as the model has it likelier; and what it misses them by (R,) [rad]."""
    point = Point(model.terms, np.asarray(model.theta))
    known = tuple(with_gain(recording) for recording in recordings)
    ways = [(one, one.misses([point])) for one in (Rollouts(known, FINE, held) for held in (True, False))]
    rollouts, missed = max(ways, key=lambda way: float(likelihood(*way)[0]))
    return rollouts, missed[:, 0]


def followed(model: Model, recording: Recording) -> tuple[Array, Array, Array]:
    """Times (R,) [s], simulated and measured positions (R,) [rad] of a recording with a drive."""
    rollouts, missed = likelier(model, [recording])
    return rollouts.time, rollouts.position + missed, rollouts.position


def in_loop(model: Model, recordings: Sequence[Recording], errors: Errors) -> Errors:
    """Errors of a model with those in the loop, if the recordings have drives."""
    if not are_driven(recordings):
        return errors
    return errors.with_loop(likelier(model, recordings)[1])
