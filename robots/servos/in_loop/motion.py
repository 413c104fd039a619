"""Motion of servos that is simulated with the controller in the loop."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.simulation.whole_motion import NOT_SIMULATED, WholeMotion
from estimators.weak_form.point import Point
from pendulum_env.physics import Model
from pendulum_env.recording import Recording
from robots.servos.in_loop.rollouts import Rollouts
from robots.servos.in_loop.servos import are_driven
from robots.servos.in_loop.settings import LOOP


def simulate_in_loop(model: Model, recordings: Sequence[Recording]) -> WholeMotion:
    """Simulate whole recordings of servos with their controllers in the loop."""
    if not are_driven(recordings):
        return NOT_SIMULATED
    rollouts = Rollouts(tuple(recordings), LOOP.simulation.fine_steps)
    positions = rollouts.positions
    error = positions.compare_paths(rollouts.simulate_paths([Point.from_model(model)]))[:, 0]
    return WholeMotion(positions.time, positions.measured, error, positions.recording_of)
