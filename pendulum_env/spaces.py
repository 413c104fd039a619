"""Spaces and argument checks of the environments."""

from collections.abc import Mapping
from numbers import Real
from typing import Any

import gymnasium as gym
import numpy as np

from pendulum_env._typing import Array
from pendulum_env.reading import quote_value

MAX_TORQUE = 15.0  # [N m], limit of the DM1015B
MAX_VELOCITY = 100.0  # [rad/s], bound of the observation; `info` is unbounded
VELOCITIES = {"difference": False, "ideal": True}  # by name: whether velocity is measured exactly
RESET_OPTIONS = dict.fromkeys(("position", "velocity", "theta", "clear_fault"))
INTEGERS = ("substeps", "num_envs")  # integer arguments


def make_spaces(max_torque: float, joints: int = 1) -> tuple[gym.spaces.Box[np.float32], gym.spaces.Box[np.float32]]:
    """Make the spaces of observations, cos q, sin q, q' [rad/s] of all joints, and of actions, torques [N m]."""
    high = np.repeat(np.array([1.0, 1.0, MAX_VELOCITY], dtype=np.float32), joints)
    observations = gym.spaces.Box(-high, high, dtype=np.float32)
    return observations, gym.spaces.Box(-max_torque, max_torque, (joints,), dtype=np.float32)


def is_beyond(torque: Any, bound: float) -> Any:
    """Return whether torques exceed a bound, compared in the single precision of the action space."""
    return np.abs(torque).astype(np.float32) > np.float32(bound)


def check_positive(owner: str, **values: float) -> None:
    """Refuse numbers that are not positive, or not integer for the names in `INTEGERS`. `owner` is for the message."""
    for argument, value in values.items():
        is_number = isinstance(value, Real)
        if not is_number or not 0 < value < np.inf or (argument in INTEGERS and value != int(value)):
            value_text = f"{value:g}" if is_number else quote_value(value)
            raise ValueError(f"{argument} of {owner} cannot be {value_text}: give a positive number")


def merge_seeds(seed: int | list[int | None] | None, count: int) -> int | None:
    """Return the seed of the one generator of a batch, which depends on all seeds of a list, one per environment."""
    if isinstance(seed, list) and len(seed) != count:
        raise ValueError(f"{len(seed)} seeds do not fit {count} environments: give one number, or one seed for each")
    if not isinstance(seed, list) or len(seed) == 1:
        return seed[0] if isinstance(seed, list) else seed
    entropy = [0 if value is None else value + 1 for value in seed]
    return int(np.random.SeedSequence(entropy).generate_state(1)[0]) if any(entropy) else None


def read_start(options: Mapping[str, Any], shape: tuple[int, ...]) -> list[Array]:
    """Read `position` [rad] and `velocity` [rad/s] of the given shape from the options of a reset; default 0."""
    start = []
    for name in ("position", "velocity"):
        try:
            start.append(np.array(np.broadcast_to(np.asarray(options.get(name, 0.0), dtype=float), shape)))
        except (TypeError, ValueError):
            start.append(np.full(shape, np.nan))
        if not np.isfinite(start[-1]).all():
            expected = f"a number{', or one for each of the pendulums' * bool(shape)}"
            raise ValueError(f"{name} of a reset cannot be {quote_value(options[name])}: give {expected}")
    return start
