"""Estimation of encoder noise from the first samples of motion, as from a whole recording."""

from collections import deque

import numpy as np

from estimators.signals.differentiation import STILL, estimate_encoder_noise
from pendulum_env._typing import Array

SAMPLES = 256  # in motion, of the first joint that has so many
SHARE = 0.25  # of these samples that another joint needs
KEPT = 2048  # samples, rest included


class SampleBuffer:
    """Samples of N pendulums or joints, until their encoder noise can be estimated.

    Attributes:
        samples: time, position and torque of each sample.
    """

    def __init__(self) -> None:
        """Create an empty buffer."""
        self.samples: deque[tuple[Array, Array, Array]] = deque(maxlen=KEPT)
        self._moved: Array = np.zeros(1)  # number of samples in motion (N,)

    def take(self, time: Array, position: Array, torque: Array) -> float | None:
        """Add a sample; return the largest standard deviation of the position noise [rad] after enough motion."""
        if self.samples:
            self._moved = self._moved + (np.abs(position - self.samples[-1][1]) > STILL).ravel()
        self.samples.append((time.copy(), position.copy(), torque.copy()))
        if np.max(self._moved) < SAMPLES:
            return None
        series = np.array([np.ravel(own) for _, own, _ in self.samples]).T  # (N, K)
        moving = series[self._moved >= SHARE * SAMPLES]
        return max(estimate_encoder_noise(own[np.isfinite(own)]) for own in moving)
