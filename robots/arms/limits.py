"""Limits of the joints of an arm, from its file and from arguments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.regression.least_squares import IdentificationError
from pendulum_env._typing import Array
from pendulum_env.excitation import DEFAULT_SPEED
from robots.arms.body import Body


@dataclass(frozen=True)
class DefaultLimits:
    """Default limits, for joints without limits in file and arguments."""

    angle: float = np.pi  # [rad] to either side
    stroke: float = 0.2  # [m] to either side
    linear_speed: float = 0.5  # [m/s], largest speed of a sliding joint
    rise: float = 0.2  # [s] from rest to the largest speed
    narrowest: float = 1e-3  # [rad] or [m], least range between limits


DEFAULT_LIMITS = DefaultLimits()


class Limits(NamedTuple):
    """Limits of the joints of an arm (n,)."""

    low: Array  # least position [rad or m]
    high: Array  # largest
    speed: Array  # largest [rad/s or m/s]
    torque: Array  # [N m or N]
    acceleration: Array  # [rad/s^2 or m/s^2]


def find_limits(
    body: Body,
    max_angle: float | None = None,
    max_speed: float | None = None,
    max_torque: float | None = None,
    max_acceleration: float | None = None,
) -> Limits:
    """Combine the limits of the file, the arguments of `design_excitation` and the defaults.

    The tightest limit of position, speed and torque applies. `max_angle` [rad], `max_speed`, `max_torque` and
    `max_acceleration` do not apply to sliding joints.

    Raises:
        IdentificationError: if a bound is not positive, or limits leave a joint no room.
    """
    bounds = {"angle": max_angle, "speed": max_speed, "torque": max_torque, "acceleration": max_acceleration}
    for name, bound in bounds.items():
        if bound is not None and not bound > 0:
            raise IdentificationError(f"{body.name}: max_{name} is {bound:g}: give a positive number")
    is_linear, joints = np.array(body.is_prismatic), np.array(body.joints)
    (low, high), default = body.position_limits, np.where(is_linear, DEFAULT_LIMITS.stroke, DEFAULT_LIMITS.angle)
    low, high = np.where(np.isfinite(low), low, -default), np.where(np.isfinite(high), high, default)
    if max_angle is not None:
        reach = np.where(is_linear, np.inf, max_angle)
        low, high = np.maximum(low, -reach), np.minimum(high, reach)
        for joint in joints[low >= high]:
            raise IdentificationError(
                f"{body.name}: '{joint}' has no position within {max_angle:g} rad of zero: give a larger max_angle"
            )
    for joint in joints[high - low < DEFAULT_LIMITS.narrowest]:
        raise IdentificationError(f"{body.name}: the limits of joint '{joint}' leave no room to move: widen them")
    speed = np.minimum(
        body.velocity_limits,
        np.where(is_linear, DEFAULT_LIMITS.linear_speed, DEFAULT_SPEED if max_speed is None else max_speed),
    )
    torque = np.minimum(body.torque_limits, np.where(is_linear, np.inf, np.inf if max_torque is None else max_torque))
    acceleration = speed / DEFAULT_LIMITS.rise
    if max_acceleration is not None:
        acceleration = np.where(is_linear, acceleration, max_acceleration)
    return Limits(low, high, speed, torque, acceleration)
