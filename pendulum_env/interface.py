"""What one pendulum and many have in common towards Gymnasium: spaces, and what their arguments may be."""

from __future__ import annotations

import gymnasium as gym
import numpy as np

MAX_TORQUE = 15.0  # [N m], of the DM1015B
MAX_VELOCITY = 100.0  # [rad/s], bound of the observation; the measurement in `info` has none
VELOCITIES = {"difference": False, "ideal": True}  # how it is measured, and whether that is exactly
RESET_OPTIONS = dict.fromkeys(("position", "velocity", "theta", "clear_fault"))
WHOLE = ("substeps", "num_envs")  # numbers that count something


def spaces(max_torque: float) -> tuple[gym.spaces.Box[np.float32], gym.spaces.Box[np.float32]]:
    """Space of an observation, cos q, sin q, q' [rad/s], and of an action, a torque [N m]."""
    high = np.array([1.0, 1.0, MAX_VELOCITY], dtype=np.float32)
    return (
        gym.spaces.Box(-high, high, dtype=np.float32),
        gym.spaces.Box(-max_torque, max_torque, (1,), dtype=np.float32),
    )


def check_positive(of: str, **values: float) -> None:
    """Refuse numbers that are not positive, or not whole where they count something.

    Raises:
        ValueError: naming the number and what it is of.
    """
    for what, value in values.items():
        if not 0 < value < np.inf or (what in WHOLE and value != int(value)):
            raise ValueError(f"{what} of {of} cannot be {value:g}: give a positive number")
