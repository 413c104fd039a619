"""Gates: comparisons of a value with its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.decisions.score import Gain
from estimators.findings import Finding
from pendulum_env._typing import JSON
from pendulum_env.quantity import Quantity, get_finite
from pendulum_env.units import to_shown_unit


@dataclass(frozen=True)
class Gate:
    """Comparison of a value with its limit.

    Attributes:
        name: compared quantity, `gain` or `holdout_torque` for example, or a parameter.
        value: value of the candidate.
        limit: bound of the value; `passed` includes the direction.
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
    def quantity(self) -> Quantity:
        """Value with its standard error."""
        return Quantity(self.value, self.std or 0.0, "" if self.unit == "1" else self.unit)

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """Name, value with its standard error and unit, limit, and `passed` or `failed`, as texts."""
        factor, of = to_shown_unit(1.0, self.unit, is_parameter=True)
        error, unit = "" if self.std is None else f" ± {factor * self.std:.2g}", "" if of == "1" else f" {of}"
        value = f"{factor * self.value:.3g}{error}{unit}"
        return self.name.replace("_", " "), value, f"{factor * self.limit:.3g}", "passed" if self.passed else "failed"

    def json(self) -> JSON:
        """Return a dictionary for JSON; numbers that are not finite become null."""
        numbers = {"value": self.value, "limit": self.limit, "std": self.std}
        finite = {name: get_finite(number) for name, number in numbers.items()}
        return {"name": self.name, **finite, "unit": self.unit, "passed": self.passed}


def limit_p_value(name: str, p_value: float, limit: float) -> Gate:
    """Make a gate on a p-value."""
    return Gate(name, p_value, limit, p_value <= limit)


def limit_total(gain: Gain, penalty: float = 0.0) -> Gate:
    """Make the gate on a gain in prediction: above its penalty [nat]."""
    std = gain.error if np.isfinite(gain.error) else None
    return Gate("gain", gain.total, penalty, gain.total > penalty, "nat", std)


def limit_gain(gain: Gain, penalty: float, p_value: float) -> list[Gate]:
    """Make the gates on a gain in prediction: above its penalty [nat], and with a small p-value."""
    return [limit_total(gain, penalty), limit_p_value("p_value", gain.p_value, p_value)]


def limit_tie(probability: float, least: float) -> Gate:
    """Make the gate on the probability of a model in the place of another."""
    return Gate("tie_probability", probability, least, probability > least)


@dataclass(frozen=True)
class FailedGates(Finding):
    """Gates that an effect failed; `selected` are the ids of effects in the model that it was added to."""

    gates: tuple[Gate, ...]
    selected: tuple[str, ...] = ()

    def has_gate(self, name: str) -> bool:
        """Return whether a gate of some name is among them."""
        return any(gate.name == name for gate in self.gates)


def explain_rejection(gates: Sequence[Gate], selected: Sequence[str] = ()) -> FailedGates | None:
    """Return a finding with the failed gates; None if all gates were passed.

    If the first failure is `gain` or `p_value`, the finding has these two gates.
    """
    failed = [gate for gate in gates if not gate.passed]
    if not failed:
        return None
    is_gain = failed[0].name in ("gain", "p_value")
    reported = [gate for gate in gates if gate.name in ("gain", "p_value")] if is_gain else failed
    return FailedGates(tuple(reported), tuple(selected))
