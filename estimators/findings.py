"""Findings on data, a model or the next step: the base of their families; see `estimators.texts` for their texts.

A family is a frozen dataclass with typed fields, beside the function that finds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum
from typing import Any

from pendulum_env._typing import JSON
from pendulum_env.notebook import summarise
from pendulum_env.quantity import Quantity as Quantity


class Verdict(StrEnum):
    """Verdict on a candidate effect."""

    SELECTED = "selected"
    AMBIGUOUS = "ambiguous"
    REJECTED = "rejected"
    NOT_EXCITED = "not_excited"

    @property
    def is_accepted(self) -> bool:
        """Return whether the effect, or one that cannot be told from it, is in the model."""
        return self in (Verdict.SELECTED, Verdict.AMBIGUOUS)


class Obstacle(StrEnum):
    """Reason why an effect is not followed online."""

    HAS_STATE = "depends_on_the_past"
    LOADS_TWO_JOINTS = "loads_two_joints"
    IS_SUDDEN = "happens_at_one_moment"
    JOINT_AT_REST = "joint_has_hardly_moved"
    NO_VARIANT = "has_no_form_here"


class Finding:
    """Base of all findings on data, a model or the next step.

    A family is a subclass and a frozen dataclass. `str(finding)` is its text. Fields that are quantities have units and
    standard errors; `recordings` is empty for all recordings.
    """

    @property
    def family(self) -> str:
        """Name of the family: `torque_timing` for `TorqueTiming`."""
        name = type(self).__name__
        return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("_")

    @property
    def withheld(self) -> tuple[str, ...]:
        """Names of parameters without a meaningful estimate."""
        return ()

    @property
    def is_total(self) -> bool:
        """Return whether no parameter has a meaningful estimate."""
        return False

    @property
    def is_biasing(self) -> bool:
        """Return whether all estimates are biased."""
        return False

    @property
    def is_open(self) -> bool:
        """Return whether another recording would settle it."""
        return False

    @property
    def rivals(self) -> tuple[str, str] | None:
        """An effect and the term of the model from which these data cannot distinguish it; None for most findings."""
        return None

    def __str__(self) -> str:
        return summarise(self)

    def json(self) -> JSON:
        """Return a dictionary for JSON: the family, the withheld parameters, and the fields by name."""
        return {"family": self.family, "withheld": [*self.withheld]} | _encode_fields(self)


def _encode_fields(record: Any) -> JSON:
    """Return the fields of a dataclass as a dictionary for JSON."""
    return {field.name: _encode(getattr(record, field.name)) for field in fields(record)}


def _encode(value: Any) -> Any:
    """Return a value of a field for JSON."""
    if hasattr(value, "json"):
        return value.json()
    if isinstance(value, Mapping):
        return {name: _encode(item) for name, item in value.items()}
    if is_dataclass(value):
        return _encode_fields(value)
    return [_encode(item) for item in value] if isinstance(value, tuple) else value


@dataclass(frozen=True)
class Change:
    """Quantity before and after a change."""

    before: Quantity
    after: Quantity


def collect_withheld(findings: Iterable[Finding]) -> set[str]:
    """Return the names of all parameters that findings withhold."""
    return {name for finding in findings for name in finding.withheld}


def bias_everything(findings: Iterable[Finding]) -> bool:
    """Return whether one of some findings marks all estimates as biased."""
    return any(finding.is_biasing for finding in findings)


def withhold_everything(findings: Iterable[Finding]) -> bool:
    """Return whether one of some findings withholds all parameters."""
    return any(finding.is_total for finding in findings)
