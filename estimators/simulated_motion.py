"""Simulation of a model under a torque, as a recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from estimators.arguments import ModelSource, check_model
from pendulum_env._typing import Array
from pendulum_env.errors import UserError
from pendulum_env.lookup import refuse_unknown_arguments
from pendulum_env.reading import quote_value
from pendulum_env.recording import Recording

Torque = Array | Sequence[float] | Callable[[float], float]
MAX_SAMPLES = 10_000_000  # of a simulation


@refuse_unknown_arguments
def simulate(
    model: ModelSource,
    torque: Torque,
    rate: float,
    *,
    seconds: float | None = None,
    position: float = 0.0,
    velocity: float = 0.0,
    name: str = "simulation",
) -> Recording:
    """Simulate the motion of a model under a torque, without noise.

    Each torque is held until the next sample, as by a motor. Integration steps are at most 1 ms long; a joint that
    sticks stands still. `Recording.columns` has the arrays `time`, `position`, `velocity` and `torque` (N,). Friction
    that depends on temperature is that at 25 deg C.

    Args:
        model: a model of a pendulum, a result with a model, or the path of a model file.
        torque: torque at each sample (N,) [N m], or in the unit of the model; or a function of the time of a sample
            [s], which returns a number.
        rate: samples per second [Hz].
        seconds: duration of a torque that is a function [s]; an array has its own.
        position: initial position [rad].
        velocity: initial velocity [rad/s].
        name: name of the recording.

    Raises:
        ModelError: if the model has no inertia, or the data did not determine it.
        TypeError: if the model is no model, or the torque or a number has another type.
        ValueError: if the model has links, a number is not finite or out of its range, or the duration is missing.
    """
    model = check_model(model)
    if not model.mechanism.can_simulate:
        raise UserError("an arm has no motion to simulate here: give the model of one joint")
    rate = _check_number("rate", rate, is_positive=True)
    start = _check_number("position", position), _check_number("velocity", velocity)
    torques = _evaluate_torque(torque, rate, seconds)
    motion = model.simulate(1.0 / rate, torques, *start)
    return Recording(
        np.arange(len(torques)) / rate,
        motion.position[:-1, 0],
        torques,
        motion.velocity[:-1, 0],
        torque_unit=model.torque_unit,
        name=name,
        is_checked=True,
    )


def _check_number(name: str, value: object, is_positive: bool = False) -> float:
    """Return a finite number, above zero if `is_positive`."""
    if isinstance(value, bool) or not isinstance(value, float | int | np.number):
        raise TypeError(f"{name}={quote_value(value)}: give a number")
    number = float(value)
    if not math.isfinite(number) or (is_positive and number <= 0):
        wanted = "number above zero" if is_positive else "finite number"
        raise UserError(f"{name} cannot be {number:g}: give a {wanted}")
    return number


def _evaluate_torque(torque: Torque, rate: float, seconds: float | None) -> Array:
    """Return the torque at each sample (N,) [N m]; raises a TypeError or ValueError as `simulate`."""
    if callable(torque):
        if seconds is None:
            raise UserError("the torque is a function without an end: give its duration, seconds=10.0")
        count = rate * _check_number("seconds", seconds, is_positive=True)
        if count > MAX_SAMPLES:
            raise UserError(f"{seconds:g} s are {count:g} samples, more than {MAX_SAMPLES:g}: give a shorter time")
        torque = [torque(k / rate) for k in range(round(count))]
    elif seconds is not None:
        raise UserError("the duration is that of the array of torques: leave seconds out")
    try:
        torques = np.array(torque, dtype=float)
    except (TypeError, ValueError):
        raise TypeError(f"torque={quote_value(torque)}: give an array of numbers, or a function of time") from None
    if torques.ndim != 1 or len(torques) < 2:
        raise UserError(f"torque has the shape {torques.shape}: give one number for each of two or more samples")
    if not np.isfinite(torques).all():
        first = int(np.argmin(np.isfinite(torques)))
        raise UserError(f"torque is {torques[first]:g} at sample {first}: give finite numbers")
    return torques
