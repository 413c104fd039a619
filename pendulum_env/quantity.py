"""Numbers with their standard errors and units, as records hold them."""

from dataclasses import dataclass
from math import isfinite

from pendulum_env._typing import JSON


@dataclass(frozen=True)
class Quantity:
    """A number with its standard error, zero where there is none, and its unit, empty of a pure number."""

    value: float
    std: float = 0.0
    unit: str = ""

    def json(self) -> JSON:
        """Plain dictionary for JSON; null stands for a number that is unknown."""
        value, std = (number if isfinite(number) else None for number in (self.value, self.std))
        return {"value": value, "std": std, "unit": self.unit}
