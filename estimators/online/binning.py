"""Samples of many pendulums, gathered in bins of motion: what models are compared on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.online.rivals import MARGIN
from estimators.online.rows import RowMaker
from estimators.online.stream import Stream
from estimators.online.watch import BIN
from estimators.schemes.six import GUARD
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask


class Bin(NamedTuple):
    """A bin of one pendulum.

    Attributes:
        of: which of the B pendulums.
        series: time, position, velocity and torque at its n + 3 instants (4, n + 3).
        y: mean torque over it [N m].
    """

    of: int
    series: Array
    y: float


class Binner:
    """Gathers samples of B pendulums; bins in stick, or close to it, are left out.

    Attributes:
        every: samples in a bin.
    """

    def __init__(self, rate: float, smoothing: Smoothing, batch: int) -> None:
        """Take the samples per second [Hz], the smoothing of the measurement, and B."""
        self.every, period = max(1, round(BIN * rate)), 1.0 / rate
        self._stream = Stream(smoothing, period, batch)
        self._rows = RowMaker((), smoothing, [GUARD], period, batch)
        self._instants = np.zeros((self._rows.behind + self.every + MARGIN - 1, 4, batch))
        self._y = np.zeros((self.every, batch))
        self._clear = np.zeros((self.every + 1, batch), dtype=bool)
        self._since = np.zeros(batch, dtype=int)  # samples, since each began
        self._step = 0

    def reset(self, which: Mask) -> None:
        """What follows of those pendulums (B,) does not continue what came."""
        self._stream.reset(which)
        self._rows.reset(which)
        self._clear[:, which], self._since[which] = False, 0

    def take(self, time: Array, position: Array, torque: Array) -> list[Bin]:
        """Take in a sample of each, as `OnlineEstimator.take`; returns the bins that are complete."""
        anew, sound = self._stream.sound(time, position, torque)
        if anew.any():
            self.reset(anew)
        now = self._stream.take(*sound)
        rows = self._rows.make(now)
        ring, every = len(self._instants), self.every
        self._instants[self._step % ring] = now.time, now.position, now.velocity, now.torque
        self._y[self._step % every] = rows.views[1, -1]
        self._clear[self._step % (every + 1)] = rows.clear[0] & (rows.index >= 0)
        self._step += 1
        self._since += 1
        if self._step % every:
            return []
        whole = np.flatnonzero(self._clear.all(axis=0) & (self._since > ring))
        if not len(whole):
            return []
        last = self._instants[(self._step + np.arange(every + MARGIN)) % ring]  # (n + 3, 4, B)
        mean = self._y.mean(axis=0)
        return [Bin(b, last[:, :, b].T.copy(), float(mean[b])) for b in whole.tolist()]
