"""Numbers with standard error and unit."""

from dataclasses import dataclass
from math import isfinite

from pendulum_env._typing import JSON


@dataclass(frozen=True)
class Quantity:
    """Number with standard error, zero if exact, and unit, empty if dimensionless."""

    value: float
    std: float = 0.0
    unit: str = ""

    def json(self) -> JSON:
        """Return a dictionary for JSON, with null for a number that is not finite."""
        value, std = (number if isfinite(number) else None for number in (self.value, self.std))
        return {"value": value, "std": std, "unit": self.unit}
