"""Reasons for the verdict on an effect: the gate that it failed, or what else decided."""

from collections.abc import Sequence

from estimators.findings import Finding, Kind, Quantity
from estimators.selection.errors import Step
from estimators.selection.gates import Gate
from pendulum_env.physics.table import Table

BY_CHANCE = Finding(Kind.BY_CHANCE)


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


def explain_table(kind: Kind, table: Table) -> Finding:
    """Return a finding about the law that a table stands for."""
    numbers = {name: Quantity(value) for name, value in table.nonlinear_values.items()}
    return Finding(kind, numbers, effects=(table.id,))


def compute_error_fall(before: Step, after: Step) -> Finding:
    """Return the fall of the held-out errors from one step to the next."""
    old, new = before.errors["holdout"], after.errors["holdout"]
    numbers: dict[str, Quantity] = {}
    for kind, unit in (old.kinds | new.kinds).items():
        unit = after.model.units().unit(unit)
        numbers |= {f"{kind}.before": Quantity(getattr(old, kind), unit=unit)}
        numbers |= {f"{kind}.after": Quantity(getattr(new, kind), unit=unit)}
    return Finding(Kind.ERRORS_FALL, numbers)
