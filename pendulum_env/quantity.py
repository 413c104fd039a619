"""Numbers with their standard errors and units, as records hold them."""

from dataclasses import dataclass
from math import isfinite

from pendulum_env._typing import JSON


@dataclass(frozen=True)
class Quantity:
    """Number with its standard error, zero if there is none, and its unit, empty for a pure number."""

    value: float
    std: float = 0.0
    unit: str = ""

    def json(self) -> JSON:
        """Return a plain dictionary for JSON; null stands for an unknown number."""
        value, std = (number if isfinite(number) else None for number in (self.value, self.std))
        return {"value": value, "std": std, "unit": self.unit}
