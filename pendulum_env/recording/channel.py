"""Channel of the torque, perhaps a current, and the known loads that determine its torque constant."""

import math
from dataclasses import dataclass

from pendulum_env._typing import JSON
from pendulum_env.errors import RecordingError
from pendulum_env.formatting import format_estimate

NEWTON_METRE = "N m"
PER_INERTIA = "rad/s^2"  # unit of a torque that is divided by the inertia


@dataclass(frozen=True)
class Load:
    """Known load that hung on the joint during one recording, in addition to the mechanism.

    A load torque that was measured is the column `load_torque` of the recording.
    """

    inertia: float  # [kg m^2] about the axis
    gravity: float  # [N m], torque that holds it out level

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
    loads: int = 0  # how many different ones it is known from, none counting as one; 0 if none told it
    by_load_torque: bool = False  # whether a measured load torque determines it

    @property
    def unit(self) -> str:
        """Return `N m/A`."""
        return f"N m/{self.of}"

    @property
    def text(self) -> str:
        """Return `torque constant 0.873 ± 0.004 N m/A, from 8 known loads`."""
        name = "torque constant" if self.of == "A" else "torque gain"
        sources = ["the load torque"] if self.by_load_torque else []
        sources += [f"{self.loads} known loads"] if self.loads > 1 else []
        source = f"from {' and '.join(sources)}" if sources else "of the model"
        return f"{name} {format_estimate(self.value, self.std)} {self.unit}, {source}"

    def json(self) -> JSON:
        """Return a plain dictionary for JSON."""
        found = {"value": self.value, "std": self.std, "unit": self.unit, "loads": self.loads}
        return {**found, "by_load_torque": self.by_load_torque}
