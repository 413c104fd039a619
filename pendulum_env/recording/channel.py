"""Unit of the torque channel, known loads, and the torque constant that they determine."""

import math
from dataclasses import dataclass

from pendulum_env._typing import JSON
from pendulum_env.errors import RecordingError
from pendulum_env.formatting import format_estimate

NEWTON_METRE = "N m"
PER_INERTIA = "rad/s^2"  # unit of torque divided by inertia


@dataclass(frozen=True)
class Load:
    """Known load on the joint during one recording, in addition to the mechanism.

    A measured load torque is the column `load_torque` of the recording.
    """

    inertia: float  # [kg m^2] about the axis
    gravity: float  # [N m], torque that holds the load horizontal

    def __post_init__(self) -> None:
        if not (math.isfinite(self.inertia) and self.inertia >= 0):
            raise RecordingError(f"a load has an inertia of 0 or more kg m^2, not {self.inertia:g}")
        if not math.isfinite(self.gravity):
            raise RecordingError(f"a load has a finite gravity torque [N m], not {self.gravity:g}")


@dataclass(frozen=True)
class TorqueConstant:
    """Torque per unit of the logged current, from known loads."""

    value: float  # [N m/unit]
    std: float  # standard error [N m/unit]
    of: str  # unit of the logged channel: `A`, `V` or `duty`
    loads: int = 0  # number of different known loads, including no load; 0 if unknown
    by_load_torque: bool = False  # whether a measured load torque determines it

    @property
    def unit(self) -> str:
        """Return the unit, `N m/A`."""
        return f"N m/{self.of}"

    @property
    def text(self) -> str:
        """Return the constant as text: `torque constant 0.873 ± 0.004 N m/A, from 8 known loads`."""
        name = "torque constant" if self.of == "A" else "torque gain"
        sources = ["the load torque"] if self.by_load_torque else []
        sources += [f"{self.loads} known loads"] if self.loads > 1 else []
        source = f"from {' and '.join(sources)}" if sources else "of the model"
        return f"{name} {format_estimate(self.value, self.std)} {self.unit}, {source}"

    def json(self) -> JSON:
        """Return a dictionary for JSON."""
        values = {"value": self.value, "std": self.std, "unit": self.unit, "loads": self.loads}
        return {**values, "by_load_torque": self.by_load_torque}
