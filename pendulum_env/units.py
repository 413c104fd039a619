"""Units and names of quantities at a joint that turns or slides, with torque in N m or another channel in its place.

Numbers are in SI everywhere. `to_shown_unit` converts angles where numbers become text, if degrees are asked for.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import degrees
from typing import TypeVar

from pendulum_env._typing import Array

T = TypeVar("T", float, Array)

PRODUCTS = {"kg m^2": "N m s^2", "J": "N m rad", "W": "N m rad/s"}  # of a torque
RELATIVE = {  # to the inertia, N m s^2/rad
    "N m s^2": "1",
    "N m s^2/rad^2": "1/rad",
    "N m s/rad": "1/s",
    "N m s/rad/K": "1/s/K",
    "N m/rad": "1/s^2",
    "N m rad": "rad^2/s^2",
    "N m rad/s": "rad^2/s^3",
}
SLIDING = {"torque": "force", "angle": "position"}  # names at a joint that slides

IN_DEGREES = {"rad": "deg", "rad/s": "deg/s", "rad within a turn": "deg within a turn"}  # units of motion, as shown

_angle = "rad"


@contextmanager
def show_angles(unit: str) -> Iterator[None]:
    """Show angles and speeds of joints in `rad` or `deg`; a context manager, or a decorator. Files stay in SI."""
    global _angle
    before, _angle = _angle, unit
    try:
        yield
    finally:
        _angle = before


def to_shown_unit(value: T, unit: str, is_parameter: bool = False) -> tuple[T, str]:
    """Convert a value and its unit to those shown: degrees for an angle or a speed, if `show_angles` asks for them.

    Args:
        value: number or array, in its unit.
        unit: SI.
        is_parameter: whether it is a parameter of a model: rad/s may be a frequency then, and stays.
    """
    if _angle == "rad" or unit not in IN_DEGREES or (is_parameter and unit != "rad"):
        return value, unit
    return value * degrees(1.0), IN_DEGREES[unit]


def is_of_torque(unit: str) -> bool:
    """Return whether a quantity with this unit grows in proportion to the torque."""
    return PRODUCTS.get(unit, unit).startswith("N m")


@dataclass(frozen=True)
class JointUnits:
    """Kind of a joint, and the channel that is recorded for its torque.

    All equations are linear in the torque, so a current in its place, or a division by the inertia, changes units only.

    Attributes:
        torque_unit: `N m`, that of a current, or `rad/s^2` where all is relative to the inertia.
        slides: whether the joint slides, and has a force for a torque.
    """

    torque_unit: str = "N m"
    slides: bool = False

    def unit(self, si: str) -> str:
        """Return the unit of a quantity by its unit where a joint turns and torque is in N m, such as `kg m^2`."""
        unit = si
        if self.torque_unit != "N m" and is_of_torque(si):
            product = PRODUCTS.get(si, si)
            per = "/rad" if self.slides and si == "kg m^2" else ""  # a turning joint omits it
            rest = f"{self.torque_unit}{product.removeprefix('N m')}{per}"
            unit = RELATIVE.get(product, rest) if self.torque_unit == "rad/s^2" else rest
        if self.slides:
            unit = "kg" if unit == "kg m^2" else unit.replace("N m", "N").replace("rad", "m")
        return unit

    def name(self, quantity: str) -> str:
        """Return the name of a quantity: `force` for `torque` where the joint slides."""
        return SLIDING.get(quantity, quantity) if self.slides else quantity


TURNING = JointUnits()
