"""The noise of an encoder, learnt from the first samples of motion."""

from collections import deque

import numpy as np

from estimators.signals.differentiation import STILL
from pendulum_env._typing import Array, Index, Mask

ORDER = 4  # of the differences, in which motion vanishes and noise does not
ENOUGH = 64  # differences near motion: simulated white noise then scatters by 20 %
SOME = 16  # of them, from which on a second position counts: 39 %


class EncoderNoise:
    """Learns the standard deviation of position noise from samples of N pendulums, or of the joints of an arm.

    Noise is the larger of two: the scatter of fourth differences near motion, and the smallest step of a position or
    its differences over sqrt(12), as of rounding. At rest a coarse encoder shows no noise, so samples at rest are not
    used.
    """

    def __init__(self) -> None:
        """Begin without a sample."""
        self._last: deque[Array] = deque(maxlen=ORDER + 1)
        self._near: list[list[float]] = []
        self._step: Array = np.array(np.inf)

    def take(self, position: Array) -> float | None:
        """Take in positions (N,) or (1, N) [rad]; returns the noise once enough samples of motion have come."""
        self._last.append(np.array(position, dtype=float).ravel())
        if len(self._last) <= ORDER:
            self._near = self._near or [[] for _ in self._last[0]]
            return None
        series = np.array(self._last)
        differences = [np.abs(np.diff(series, k, axis=0)) for k in range(1, ORDER + 1)]
        sizes = np.concatenate(differences)
        self._step = np.fmin(self._step, np.where(sizes > STILL, sizes, np.inf).min(axis=0))
        moved: Mask = np.any(differences[0] > STILL, axis=0, keepdims=True)[0]
        for k in np.flatnonzero(moved & np.isfinite(differences[-1][0])):
            self._near[k].append(float(differences[-1][0, k]))
        count: Index = np.array([len(own) for own in self._near])
        if count.max() < ENOUGH:
            return None
        gain = 0.6745 * np.sqrt(70.0)  # of the median size of fourth differences, from one of their values
        learnt = [
            max(float(np.median(own)) / gain, step / np.sqrt(12))
            for own, step in zip(self._near, self._step, strict=True)
            if len(own) >= SOME
        ]
        return max(learnt)
