"""Units and names of quantities of a revolute or linear joint, with torque or another channel in its place.

Numbers are in SI units. `to_shown_unit` converts angles for display if degrees are selected.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import degrees
from typing import TypeVar

from pendulum_env._typing import Array

T = TypeVar("T", float, Array)

PRODUCTS = {"kg m^2": "N m s^2", "kg m": "N m s^2/m", "J": "N m rad", "W": "N m rad/s"}  # units as multiples of N m
RELATIVE = {  # units after division by the inertia [N m s^2/rad]
    "N m s^2": "1",
    "N m s^2/rad^2": "1/rad",
    "N m s/rad": "1/s",
    "N m s/rad/K": "1/s/K",
    "N m/rad": "1/s^2",
    "N m rad": "rad^2/s^2",
    "N m rad/s": "rad^2/s^3",
}
NAMES_OF_LINEAR = {"torque": "force", "angle": "position"}  # names of quantities of a linear joint

IN_DEGREES = {"rad": "deg", "rad/s": "deg/s", "rad within a turn": "deg within a turn"}  # displayed units of motion

_angle = "rad"


@contextmanager
def show_angles(unit: str) -> Iterator[None]:
    """Show angles and speeds in `rad` or `deg` within a context or a decorated function; files stay in SI."""
    global _angle
    previous, _angle = _angle, unit
    try:
        yield
    finally:
        _angle = previous


def to_shown_unit(value: T, unit: str, is_parameter: bool = False) -> tuple[T, str]:
    """Convert a value and its unit for display: angles and speeds to degrees within `show_angles("deg")`.

    Args:
        value: number or array.
        unit: SI unit of the value.
        is_parameter: whether the value is a model parameter; rad/s may then be a frequency and is kept.
    """
    if _angle == "rad" or unit not in IN_DEGREES or (is_parameter and unit != "rad"):
        return value, unit
    return value * degrees(1.0), IN_DEGREES[unit]


def is_of_torque(unit: str) -> bool:
    """Return whether a quantity with this unit is proportional to torque."""
    return PRODUCTS.get(unit, unit).startswith("N m")


@dataclass(frozen=True)
class JointUnits:
    """Units of a joint, by its kind and the recorded channel of its torque.

    The equations are linear in the torque: current in place of torque, or division by the inertia, changes only units.

    Attributes:
        torque_unit: `N m`, the unit of a current, or `rad/s^2` for torque divided by inertia.
        is_prismatic: whether the joint is linear, with force in place of torque.
    """

    torque_unit: str = "N m"
    is_prismatic: bool = False

    def unit(self, si: str) -> str:
        """Return the unit of a quantity from its unit at a revolute joint with torque in N m, such as `kg m^2`."""
        unit = si
        if self.torque_unit != "N m" and is_of_torque(si):
            product = PRODUCTS.get(si, si)
            per = "/rad" if self.is_prismatic and si == "kg m^2" else ""  # omitted at a revolute joint
            channel_unit = f"{self.torque_unit}{product.removeprefix('N m')}{per}"
            unit = RELATIVE.get(product, channel_unit) if self.torque_unit == "rad/s^2" else channel_unit
        if self.is_prismatic:
            unit = "kg" if unit == "kg m^2" else unit.replace("N m", "N").replace("rad", "m")
        return unit

    def name(self, quantity: str) -> str:
        """Return the name of a quantity; `force` for `torque` of a linear joint."""
        return NAMES_OF_LINEAR.get(quantity, quantity) if self.is_prismatic else quantity


TURNING = JointUnits()
