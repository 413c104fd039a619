"""Preparation of recordings by the kind of their actuator, whose settings may be open."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

from estimators.decisions.criterion import Criterion
from estimators.findings import Finding
from estimators.simulation.whole_motion import NOT_SIMULATED, WholeMotion
from pendulum_env._typing import JSON
from pendulum_env.physics import Model, Term
from pendulum_env.plugins import load_plugins, make_missing_error
from pendulum_env.recording import Recording

ENTRY_POINTS = "pendulum_ident.cases"
Recordings = tuple[Recording, ...]


class Prepared(NamedTuple):
    """Fitted and held-out recordings with decided settings, and findings on these decisions."""

    recordings: Recordings
    holdout: Recordings
    findings: tuple[Finding, ...] = ()


class Preparation:
    """Preparation of recordings; that of a pendulum under a known torque changes nothing.

    A kind of actuator whose torque depends on open settings overrides these methods.

    Attributes:
        models: functions that make a model of a mechanism from the content of a file, by its schema.
    """

    models: ClassVar[Mapping[str, Callable[[JSON, Any], Any]]] = {}

    def prepares(self, recordings: Sequence[Recording]) -> bool:
        """Return whether recordings belong to the kind."""
        return True

    def declare(self, recordings: Sequence[Recording], settings: Mapping[str, Any]) -> Recordings:
        """Return recordings with settings of a log format that they leave open."""
        return tuple(recordings)

    def complete(
        self, recordings: Sequence[Recording], settings: Mapping[str, Any], criterion: Criterion
    ) -> Recordings:
        """Return recordings with all settings: those of a log format, then decided ones."""
        return tuple(recordings)

    def decide_torque(
        self, recordings: Recordings, holdout: Recordings, base: Sequence[Term], criterion: Criterion
    ) -> Prepared:
        """Return recordings with the settings on which their torque depends, decided by fits of a base model."""
        return Prepared(recordings, holdout)

    def list_decisions(self, findings: Sequence[Finding]) -> Sequence[Finding]:
        """List the last decisions on open settings among findings on recordings."""
        return ()

    def simulate(self, model: Model, recordings: Sequence[Recording]) -> WholeMotion:
        """Simulate whole recordings under a model, from what moves them, without their torque."""
        return NOT_SIMULATED


UNCHANGED = Preparation()
_registered: list[Preparation] = []


def register_preparation(preparation: Preparation) -> None:
    """Add a preparation to those of this process; it is asked before those that were registered earlier."""
    if preparation not in _registered:
        _registered.insert(0, preparation)


def list_preparations() -> tuple[Preparation, ...]:
    """List the registered preparations, then those of installed packages by the name of their entry point."""
    return (*_registered, *(item for item in _load_installed() if item not in _registered))


@cache
def _load_installed() -> tuple[Preparation, ...]:
    """Load the preparations of installed packages; warn of other objects."""
    plugins = load_plugins(ENTRY_POINTS)
    for name, item in plugins.items():
        if not isinstance(item, Preparation | ModuleType):
            warnings.warn(f"'{name}' of {ENTRY_POINTS} is no case: name an object, not its class", stacklevel=2)
    return tuple(item for item in plugins.values() if isinstance(item, Preparation))


def find_preparation(recordings: Sequence[Recording]) -> Preparation:
    """Return the first preparation for the kind of some recordings.

    Raises:
        UserError: if a recording has a controller, and no installed package prepares it.
    """
    for item in list_preparations():
        if item.prepares(recordings):
            return item
    if any(recording.actuator.is_controller for recording in recordings):
        raise make_missing_error(ENTRY_POINTS, "prepares recordings with a drive")
    return UNCHANGED
