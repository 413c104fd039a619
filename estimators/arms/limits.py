"""What the joints of an arm may do, by its file and by what is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.regression.equations import IdentificationError
from pendulum_env._typing import Array
from pendulum_env.arms.body import Body
from pendulum_env.excitation import USUAL_SPEED


@dataclass(frozen=True)
class UsualLimits:
    """Limits where neither file nor argument has one, and what is kept of them."""

    angle: float = np.pi  # [rad] to either side
    stroke: float = 0.2  # [m] to either side
    slide: float = 0.5  # [m/s], largest speed of a joint that slides
    rise: float = 0.2  # [s] from rest to the largest speed
    narrowest: float = 1e-3  # [rad] or [m] between limits, below which a motion is of no use


USUAL = UsualLimits()


class Limits(NamedTuple):
    """What the joints of an arm may do (n,)."""

    low: Array  # least position [rad or m]
    high: Array  # largest
    speed: Array  # largest [rad/s or m/s]
    torque: Array  # [N m or N]
    acceleration: Array  # [rad/s^2 or m/s^2]


def limits_of(
    body: Body,
    max_angle: float | None = None,
    max_speed: float | None = None,
    max_torque: float | None = None,
    max_acceleration: float | None = None,
) -> Limits:
    """Limits of the file, of arguments as in `design_excitation`, and usual ones where neither has any.

    Raises:
        IdentificationError: if a bound is not positive, or they leave a joint no room.
    """
    bounds = {"angle": max_angle, "speed": max_speed, "torque": max_torque, "acceleration": max_acceleration}
    for name, bound in bounds.items():
        if bound is not None and not bound > 0:
            raise IdentificationError(f"{body.name}: the largest {name} cannot be {bound:g}: give a number above zero")
    slides, joints = np.array(body.slides), np.array(body.joints)
    (low, high), usual = body.position_limits, np.where(slides, USUAL.stroke, USUAL.angle)
    low, high = np.where(np.isfinite(low), low, -usual), np.where(np.isfinite(high), high, usual)
    if max_angle is not None:
        reach = np.where(slides, np.inf, max_angle)
        low, high = np.maximum(low, -reach), np.minimum(high, reach)
        for joint in joints[low >= high]:
            raise IdentificationError(
                f"{body.name}: joint '{joint}' is never within {max_angle:g} rad of zero: allow a larger angle"
            )
    for joint in joints[high - low < USUAL.narrowest]:
        raise IdentificationError(f"{body.name}: the limits of joint '{joint}' leave it no room to move: widen them")
    speed = np.minimum(
        body.velocity_limits, np.where(slides, USUAL.slide, USUAL_SPEED if max_speed is None else max_speed)
    )
    torque = np.minimum(body.torque_limits, np.where(slides, np.inf, np.inf if max_torque is None else max_torque))
    rise = speed / USUAL.rise
    acceleration = np.where(slides, rise, rise if max_acceleration is None else max_acceleration)
    return Limits(low, high, speed, torque, acceleration)
