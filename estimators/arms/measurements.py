"""Measurements of an arm: those of each joint, at the same instants and through the same filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimators.regression.equations import IdentificationError
from estimators.signals.measurements import SPARE, Measurements, choose_smoothing, measure, remember
from pendulum_env._typing import Array
from pendulum_env.arms.recording import ArmRecording
from pendulum_env.physics import Term


@dataclass(frozen=True, eq=False)
class ArmMeasurements:
    """N samples of n joints; stick is known joint by joint. Build them with `measure_arm`."""

    joints: tuple[Measurements, ...]

    def __len__(self) -> int:
        return len(self.joints[0])

    @property
    def period(self) -> float:
        """Between samples [s]."""
        return self.joints[0].period

    @property
    def time(self) -> Array:
        """(N,) [s]."""
        return self.joints[0].time

    @cached_property
    def position(self) -> Array:
        """Smoothed (N, n) [rad]."""
        return self._stacked(lambda m: m.position)

    @cached_property
    def velocity(self) -> Array:
        """Smoothed (N, n) [rad/s]."""
        return self._stacked(lambda m: m.velocity)

    @cached_property
    def acceleration(self) -> Array:
        """Smoothed (N, n) [rad/s^2]."""
        return self._stacked(lambda m: m.acceleration)

    @property
    def torque(self) -> Array:
        """At the instants (N, n) [N m]."""
        return self._stacked(lambda m: m.torque)

    def _stacked(self, of: Callable[[Measurements], Array]) -> Array:
        return np.column_stack([of(m) for m in self.joints])

    def remember(self, terms: Sequence[Term], names: Sequence[str]) -> ArmMeasurements:
        """The same with the states of terms that have any, each along its own joint."""
        return ArmMeasurements(
            tuple(
                remember(m, [own for own in terms if own.at == name])
                for name, m in zip(names, self.joints, strict=True)
            )
        )


def measure_arm(recording: ArmRecording) -> list[ArmMeasurements]:
    """Measurements of each segment of a recording; those too short to differentiate are left out.

    All joints pass the longest of the windows that the joints ask for: their rows of the balance share all motion.

    Raises:
        IdentificationError: if all segments are too short.
    """
    segments = recording.segments
    longest = max(segments, key=len)
    for joint in longest.joints:
        if len(joint) < SPARE:
            measure(joint)  # says so
    chosen = [choose_smoothing(joint) for joint in longest.joints]
    width = max(smoothing.half_width for smoothing in chosen)
    long_enough = [segment for segment in segments if len(segment) >= 2 * width + SPARE]
    if not long_enough:
        raise IdentificationError(f"{recording.name}: no segment is long enough to differentiate: record longer")
    return [
        ArmMeasurements(
            tuple(
                measure(joint, replace(smoothing, half_width=width))
                for joint, smoothing in zip(segment.joints, chosen, strict=True)
            )
        )
        for segment in long_enough
    ]
