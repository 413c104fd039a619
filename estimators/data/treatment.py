"""Treatments of recordings before a model is fitted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from estimators.findings import Finding, Quantity


class Action(StrEnum):
    """Action of a treatment; comments name its quantities."""

    TORQUE_CONSTANT = "torque_constant"  # torque_constant: currents are converted by it
    NARROWER_WINDOWS = "narrower_windows"  # share of the length
    WINDOWS_BY_INERTIA = "windows_by_inertia"  # inertia of the model, and that `before`, of the base model
    IMPACTS_INCLUDED = "impacts_included"
    RECORDINGS_EXCLUDED = "recordings_excluded"
    TIMED_BESIDE = "timed_beside"
    TIMED_AS_LOGGED = "timed_as_logged"
    BACK_EMF_INCLUDED = "back_emf_included"


@dataclass(frozen=True)
class Treatment(Finding):
    """Treatment of recordings.

    Attributes:
        action: its action.
        quantities: quantities of the action by name, see `Action`.
        effects: ids of the effects of a timing.
        recordings: names of excluded recordings.
    """

    action: Action
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ()
