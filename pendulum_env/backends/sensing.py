"""Sensors of a simulated rig: encoder, torque and velocity."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pendulum_env._typing import Array, ArrayLike

COUNTS = 1_024_000  # counts per turn of the paper's encoder


@dataclass(frozen=True)
class Sensor:
    """Encoder and torque sensor.

    Velocity is exact, or the backward difference of the angle as in the paper, half a period late and quantised.
    """

    counts: int = COUNTS  # encoder counts per turn; 0 measures the angle exactly
    torque_noise: float = 0.0  # standard deviation of the white noise on the measured torque [N m]
    ideal_velocity: bool = False

    def __post_init__(self) -> None:
        if not self.counts >= 0 or self.counts != int(self.counts) or not 0 <= self.torque_noise < np.inf:
            raise ValueError(
                f"counts ({self.counts}) and torque_noise ({self.torque_noise:g}) have to be numbers from zero on, and "
                "counts a whole one"
            )

    def position(self, position: Any) -> Any:
        """Return the measured angle [rad], rounded to counts."""
        if self.counts == 0:
            return np.asarray(position)
        count = 2 * math.pi / self.counts
        if isinstance(position, float):  # a scalar function of NumPy takes longer
            return count * round(position / count)
        rounded: Array = np.rint(position / count)
        return count * rounded

    def measure(self, position: Array, velocity: Array, previous: Array, rate: float) -> tuple[Array, Array]:
        """Return measured position [rad] and velocity [rad/s]; `previous` is the previous measured position [rad]."""
        measured = self.position(position)
        return measured, velocity if self.ideal_velocity else (measured - previous) * rate

    def torque(self, torque: ArrayLike, rng: np.random.Generator) -> ArrayLike:
        """Return the measured torque [N m]."""
        if self.torque_noise == 0:
            return torque
        return torque + self.torque_noise * rng.standard_normal(np.shape(torque))
