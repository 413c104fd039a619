"""Errors of a model on data: of its torque, and of its free-running position."""

import numpy as np

from estimators.data.regression_data import RegressionData
from estimators.decisions.errors import Errors
from estimators.simulation.free_running import compute_deviation, compute_position_rms
from pendulum_env.physics import Model
from pendulum_env.physics.joints import find_mechanism


def compute_errors(data: RegressionData, model: Model) -> Errors:
    """Return the errors of a model in torque, of each joint and of all, and in free-running position.

    Rollouts have only the error in the loop. The torque of all joints is nan if some slide and others turn; the
    position is nan without segments or a known inertia.
    """
    residual, mechanism, layout = data.residual(model.terms, model.theta), find_mechanism(data.base), data.layout
    if layout.errors is not None:
        return layout.errors(residual)
    torque, position, fit = float(np.sqrt(np.mean(residual**2))), np.nan, np.nan
    torque = torque if len({*mechanism.is_prismatic}) == 1 else np.nan
    joints, sizes = layout.compute_joint_errors(residual), layout.compute_joint_errors(data.data.torque.recorded)
    shares = {at: error / sizes[at] if sizes[at] else None for at, error in joints.items()}
    if data.segments and model.has_known_inertia:
        position = compute_position_rms(data.segments, model.terms, model.theta)
        fit = _compute_fit_percent(position, compute_deviation(data.segments))
    torque_fit = _compute_fit_percent(torque, float(np.std(data.data.torque.applied)))
    return Errors(torque, position, torque_fit, fit, joints, shares)


def _compute_fit_percent(error: float, deviation: float) -> float:
    """Return 100 (1 - error / deviation) [%]; 0 without deviation."""
    return 100.0 * (1.0 - error / deviation) if deviation > 0 else 0.0
