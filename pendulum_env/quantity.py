"""Numbers with standard error and unit."""

import math
from dataclasses import dataclass

from pendulum_env._typing import JSON


@dataclass(frozen=True)
class Quantity:
    """Number with standard error, zero if exact, and unit, empty if dimensionless."""

    value: float
    std: float = 0.0
    unit: str = ""

    def json(self) -> JSON:
        """Return a dictionary for JSON, with null for a number that is not finite."""
        return {"value": get_finite(self.value), "std": get_finite(self.std), "unit": self.unit}


def get_finite(number: float | None) -> float | None:
    """Return a number for JSON, or None, which is null, for a number that is not finite."""
    return None if number is None or not math.isfinite(number) else float(number)
