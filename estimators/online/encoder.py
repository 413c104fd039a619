"""Estimation of encoder noise from the first samples of motion."""

from collections import deque
from math import comb

import numpy as np

from estimators.signals.differentiation import STILL
from pendulum_env._typing import Array, Index, Mask

ORDERS = (4, 6, 8)  # of differences; a high order removes the motion at low rates, and keeps the noise
GAINS = 0.6745 * np.sqrt([comb(2 * order, order) for order in ORDERS])  # median size of differences of white noise
WINDOW = 5  # samples that decide whether the joint moves
MIN_DIFFERENCES = 64  # differences in motion; the estimate then scatters by 20 %
MIN_SECOND_DIFFERENCES = 16  # differences of a further joint; 39 %


class EncoderNoise:
    """Estimator of the standard deviation of position noise from samples of N pendulums or joints.

    The noise is the larger of two values: the least scatter of differences of several orders in motion, and the
    smallest step of a position or its differences, divided by sqrt(12), as of rounding. Samples at rest are not used,
    because a coarse encoder shows no noise at rest.
    """

    def __init__(self) -> None:
        """Create an estimator without samples."""
        self._last: deque[Array] = deque(maxlen=ORDERS[-1] + 1)
        self._near: list[list[Array]] = []
        self._step: Array = np.array(np.inf)

    def take(self, position: Array) -> float | None:
        """Add positions (N,) or (1, N) [rad]; return the noise when there are enough samples in motion."""
        self._last.append(np.array(position, dtype=float).ravel())
        if len(self._last) <= ORDERS[-1]:
            self._near = self._near or [[] for _ in self._last[0]]
            return None
        series = np.array(self._last)
        steps = [np.abs(np.diff(series[-WINDOW:], order, axis=0)) for order in range(1, WINDOW)]
        sizes = np.concatenate(steps)
        self._step = np.fmin(self._step, np.where(sizes > STILL, sizes, np.inf).min(axis=0))
        moved: Mask = np.any(steps[0] > STILL, axis=0, keepdims=True)[0]
        differences = np.abs([np.diff(series, order, axis=0)[-1] for order in ORDERS])
        for k in np.flatnonzero(moved & np.isfinite(differences[-1])):
            self._near[k].append(differences[:, k])
        count: Index = np.array([len(own) for own in self._near])
        if count.max() < MIN_DIFFERENCES:
            return None
        learnt = [
            max(float((np.median(own, axis=0) / GAINS).min()), step / np.sqrt(12))
            for own, step in zip(self._near, self._step, strict=True)
            if len(own) >= MIN_SECOND_DIFFERENCES
        ]
        return max(learnt)
