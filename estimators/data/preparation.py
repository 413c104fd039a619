"""Preparation of recordings by the kind of their actuator: open settings, and simulated motion of whole recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from estimators.decisions.criterion import Criterion
from estimators.decisions.errors import Errors
from estimators.findings import Finding
from pendulum_env._typing import Array, Index
from pendulum_env.physics import Model, Term
from pendulum_env.plugins import load_plugins
from pendulum_env.recording import Recording

ENTRY_POINTS = "pendulum_ident.cases"
Recordings = tuple[Recording, ...]


@dataclass(frozen=True)
class WholeMotion:
    """Simulated and measured motion of whole recordings (R,); without rows, and false, if it is not simulated.

    Attributes:
        time: from the start of each recording [s].
        measured: position [rad].
        error: simulated minus measured position [rad].
        recording_of: number of the recording.
    """

    time: Array
    measured: Array
    error: Array
    recording_of: Index

    def __bool__(self) -> bool:
        return bool(len(self.error))

    @property
    def simulated_position(self) -> Array:
        """Return the simulated position (R,) [rad]."""
        return self.measured + self.error

    def extend(self, errors: Errors) -> Errors:
        """Extend errors by those of this motion, if it has rows."""
        return errors.with_loop_errors(self.error) if self else errors

    def select_recording(self, number: int) -> WholeMotion:
        """Return the motion of one recording."""
        rows = self.recording_of == number
        return WholeMotion(self.time[rows], self.measured[rows], self.error[rows], self.recording_of[rows])

    def interpolate(self, recording: Recording) -> Array:
        """Return the simulated position at the samples (N,) of the recording of this motion [rad].

        It is NaN after the last simulated position.
        """
        path = []
        for segment in recording.segments:
            time = segment.time - recording.time[0]
            is_inside = (self.time > time[0]) & (self.time <= time[-1])
            points = (
                np.r_[time[0], self.time[is_inside]],
                np.r_[segment.position[0], self.simulated_position[is_inside]],
            )
            path.append(np.interp(time, *points, right=np.nan))
        return np.concatenate(path)


NOT_SIMULATED = WholeMotion(np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.intp))


class Prepared(NamedTuple):
    """Fitted and held-out recordings with decided settings, and findings on these decisions."""

    recordings: Recordings
    holdout: Recordings
    findings: tuple[Finding, ...] = ()


class Preparation:
    """Preparation of recordings; that of a pendulum under a known torque changes nothing.

    A kind of actuator whose torque depends on open settings overrides these methods.
    """

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
    """List the registered preparations, then those of installed packages."""
    installed = [item for item in load_plugins(ENTRY_POINTS) if isinstance(item, Preparation)]
    return (*_registered, *(item for item in installed if item not in _registered))


def find_preparation(recordings: Sequence[Recording]) -> Preparation:
    """Return the first preparation for the kind of some recordings."""
    return next((item for item in list_preparations() if item.prepares(recordings)), UNCHANGED)
