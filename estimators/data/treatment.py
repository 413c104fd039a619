"""Treatments of recordings before a model is fitted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from estimators.findings import Finding, Quantity


class Action(StrEnum):
    """Actions of treatments of the core; comments name their quantities."""

    TORQUE_CONSTANT = "torque_constant"  # torque_constant: currents are converted by it
    NARROWER_WINDOWS = "narrower_windows"  # share of the length
    WINDOWS_BY_INERTIA = "windows_by_inertia"  # inertia of the model, and that `before`, of the base model
    IMPACTS_INCLUDED = "impacts_included"
    RECORDINGS_EXCLUDED = "recordings_excluded"
    TIMED_BY_MODEL = "timed_by_model"
    TIMED_AS_LOGGED = "timed_as_logged"


class DataChange:
    """Mixin of findings on treatments of recordings."""

    @property
    def n_assumptions(self) -> int:
        """Return the number of assumptions, by which equal predictions are compared."""
        return 0

    @property
    def has_new_inputs(self) -> bool:
        """Return whether it changes loads or references: models with and without it have their own data."""
        return False

    @property
    def topic(self) -> str | None:
        """Return the decision that it repeats, in the place of an earlier one; None for a treatment of its own."""
        return None


@dataclass(frozen=True)
class Treatment(DataChange, Finding):
    """Treatment of recordings.

    Attributes:
        action: its action, one of `Action` or that of a plug-in.
        quantities: quantities of the action by name, see `Action`.
        effects: ids of the effects of a timing.
        recordings: names of excluded recordings.
        n_assumptions: number of assumptions, by which equal predictions are compared.
    """

    action: str
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ()
    n_assumptions: int = 0
