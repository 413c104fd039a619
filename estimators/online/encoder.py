"""The noise of an encoder, learnt from the first samples of motion."""

from collections import deque
from math import comb

import numpy as np

from estimators.signals.differentiation import STILL
from pendulum_env._typing import Array, Index, Mask

ORDERS = (4, 6, 8)  # of differences, in which motion vanishes, at low rates in high ones only, and noise does not
GAINS = 0.6745 * np.sqrt([comb(2 * order, order) for order in ORDERS])  # of the median size of white noise
NEAR = 5  # samples that show steps and motion
ENOUGH = 64  # differences near motion: simulated white noise then scatters by 20 %
SOME = 16  # of them, from which on a second position counts: 39 %


class EncoderNoise:
    """Learns the standard deviation of position noise from samples of N pendulums, or of the joints of an arm.

    Noise is the larger of two: the least scatter of differences of several orders near motion, and the smallest step of
    a position or its differences over sqrt(12), as of rounding. At rest a coarse encoder shows no noise, so samples at
    rest are not used.
    """

    def __init__(self) -> None:
        """Begin without a sample."""
        self._last: deque[Array] = deque(maxlen=ORDERS[-1] + 1)
        self._near: list[list[Array]] = []
        self._step: Array = np.array(np.inf)

    def take(self, position: Array) -> float | None:
        """Take in positions (N,) or (1, N) [rad]; returns the noise once enough samples of motion have come."""
        self._last.append(np.array(position, dtype=float).ravel())
        if len(self._last) <= ORDERS[-1]:
            self._near = self._near or [[] for _ in self._last[0]]
            return None
        series = np.array(self._last)
        steps = [np.abs(np.diff(series[-NEAR:], order, axis=0)) for order in range(1, NEAR)]
        sizes = np.concatenate(steps)
        self._step = np.fmin(self._step, np.where(sizes > STILL, sizes, np.inf).min(axis=0))
        moved: Mask = np.any(steps[0] > STILL, axis=0, keepdims=True)[0]
        differences = np.abs([np.diff(series, order, axis=0)[-1] for order in ORDERS])
        for k in np.flatnonzero(moved & np.isfinite(differences[-1])):
            self._near[k].append(differences[:, k])
        count: Index = np.array([len(own) for own in self._near])
        if count.max() < ENOUGH:
            return None
        learnt = [
            max(float((np.median(own, axis=0) / GAINS).min()), step / np.sqrt(12))
            for own, step in zip(self._near, self._step, strict=True)
            if len(own) >= SOME
        ]
        return max(learnt)
