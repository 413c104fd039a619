"""Signs of estimates that noise does not explain."""

from dataclasses import dataclass

import numpy as np

from estimators.findings import Finding
from estimators.weak_form.columns import is_friction_table
from pendulum_env.physics import Model


@dataclass(frozen=True)
class NegativeParameters(Finding):
    """Parameters that came out negative, which is unphysical: friction, or gravity beside a spring."""

    parameters: tuple[str, ...]

    @property
    def is_biasing(self) -> bool:
        """Return whether the negative friction stands for a law that the model lacks, which biases the others."""
        return True


def find_driving_friction(model: Model) -> list[NegativeParameters]:
    """Return a finding with the dry and viscous friction parameters that are significantly negative, or an empty list.

    With a table of friction they may have any sign.
    """
    if any(map(is_friction_table, model.terms)):
        return []
    friction = [term for term in model.terms if term.kind == "dissipative"]
    names = [column.name for term in friction for column in term.columns if column.is_of_body]
    negative = [name for name in names if is_significantly_negative(model, name)]
    return [NegativeParameters(tuple(negative))] if negative else []


def is_significantly_negative(model: Model, name: str) -> bool:
    """Return whether an estimate is negative by more than 3 standard errors."""
    return compute_significant_sign(model, name) < 0


def compute_significant_sign(model: Model, name: str) -> int:
    """Return the sign of an estimate; 0 within 3 standard errors of zero, or if it is missing, unknown or given."""
    estimate = model.estimates.get(name)
    if estimate is None or estimate.is_unknown or estimate.std <= 0 or not estimate.is_significant:
        return 0
    return int(np.sign(estimate.value))
