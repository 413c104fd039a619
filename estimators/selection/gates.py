"""Gates: tests that a candidate effect meets, with their values and limits."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.findings import Finding, Kind, Quantity
from pendulum_env._typing import JSON
from pendulum_env.units import to_shown_unit


@dataclass(frozen=True)
class Gate:
    """Comparison of a value with its limit.

    Attributes:
        name: quantity that is compared: `gain`, `p_value`, `explained_share`, `holdout_torque`, ..., or a parameter.
        value: of the candidate.
        limit: bound of the value.
        passed: whether the value is on the right side of its limit.
        unit: of value and limit; "1" for numbers.
        std: standard error of the value; None if it is unknown.
    """

    name: str
    value: float
    limit: float
    passed: bool
    unit: str = "1"
    std: float | None = None

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """Name, value with its standard error and unit, limit, and `passed` or `failed`, as texts."""
        factor, of = to_shown_unit(1.0, self.unit, is_parameter=True)
        error, unit = "" if self.std is None else f" ± {factor * self.std:.2g}", "" if of == "1" else f" {of}"
        value = f"{factor * self.value:.3g}{error}{unit}"
        return self.name.replace("_", " "), value, f"{factor * self.limit:.3g}", "passed" if self.passed else "failed"

    def json(self) -> JSON:
        """Plain dictionary for JSON."""
        numbers = {"value": self.value, "limit": self.limit, "std": self.std}
        finite = {name: own if own is not None and np.isfinite(own) else None for name, own in numbers.items()}
        return {"name": self.name, **finite, "unit": self.unit, "passed": self.passed}


def explain_rejection(gates: Sequence[Gate], selected: Sequence[str] = ()) -> Finding | None:
    """Return the first gate that failed as a finding; None if all gates were passed.

    A gain comes with its p-value, and a violated bound with all others. Limits are numbers named `limit.` and the gate.

    Args:
        gates: met by an effect, in order.
        selected: effects beside which it was tried.
    """
    failed = [gate for gate in gates if not gate.passed]
    if not failed:
        return None
    is_gain = failed[0].name in ("gain", "p_value")
    told = [gate for gate in gates if gate.name in ("gain", "p_value")] if is_gain else failed
    numbers: dict[str, Quantity] = {}
    for gate in told:
        unit = "" if gate.unit == "1" else gate.unit
        numbers |= {gate.name: Quantity(gate.value, gate.std or 0.0, unit)}
        numbers |= {f"limit.{gate.name}": Quantity(gate.limit, unit=unit)}
    return Finding(Kind.GATE_FAILED, numbers, tuple(gate.name for gate in told), tuple(selected))
