"""Spaces and argument checks shared by the environments of one and of many pendulums."""

from collections.abc import Mapping
from numbers import Real
from typing import Any

import gymnasium as gym
import numpy as np

from pendulum_env._typing import Array
from pendulum_env.reading import quote_value

MAX_TORQUE = 15.0  # [N m], of the DM1015B
MAX_VELOCITY = 100.0  # [rad/s], bound of the observation; the measurement in `info` has none
VELOCITIES = {"difference": False, "ideal": True}  # how it is measured, and whether that is exactly
RESET_OPTIONS = dict.fromkeys(("position", "velocity", "theta", "clear_fault"))
WHOLE = ("substeps", "num_envs")  # numbers that count something


def make_spaces(max_torque: float, joints: int = 1) -> tuple[gym.spaces.Box[np.float32], gym.spaces.Box[np.float32]]:
    """Make the spaces of an observation, cos q, sin q, q' [rad/s] of all joints, and of an action, torques [N m]."""
    high = np.repeat(np.array([1.0, 1.0, MAX_VELOCITY], dtype=np.float32), joints)
    return (
        gym.spaces.Box(-high, high, dtype=np.float32),
        gym.spaces.Box(-max_torque, max_torque, (joints,), dtype=np.float32),
    )


def is_beyond(torque: Any, most: float) -> Any:
    """Return whether torques exceed a bound in single precision, as in the action space."""
    return np.abs(torque).astype(np.float32) > np.float32(most)


def check_positive(of: str, **values: float) -> None:
    """Refuse numbers that are not positive, or not whole where they count something."""
    for what, value in values.items():
        is_number = isinstance(value, Real)
        if not is_number or not 0 < value < np.inf or (what in WHOLE and value != int(value)):
            given = f"{value:g}" if is_number else quote_value(value)
            raise ValueError(f"{what} of {of} cannot be {given}: give a positive number")


def read_start(options: Mapping[str, Any], shape: tuple[int, ...]) -> list[Array]:
    """Read `position` [rad] and `velocity` [rad/s] from the options of a reset, 0 by default, of that shape each."""
    start = []
    for name in ("position", "velocity"):
        try:
            start.append(np.array(np.broadcast_to(np.asarray(options.get(name, 0.0), dtype=float), shape)))
        except (TypeError, ValueError):
            start.append(np.full(shape, np.nan))
        if not np.isfinite(start[-1]).all():
            wanted = f"a number{', or one for each of the pendulums' * bool(shape)}"
            raise ValueError(f"{name} of a reset cannot be {quote_value(options[name])}: give {wanted}")
    return start
