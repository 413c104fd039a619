"""Samples of many pendulums, gathered in bins of motion: what models are compared on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.online.rivals import MARGIN
from estimators.online.rows import POSITION, TIME, TORQUE, VELOCITY
from estimators.online.stream import Stream
from estimators.online.watch import BIN
from estimators.schemes.six import scheme
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
        self.every = max(1, round(BIN * rate))
        self._stream = Stream((), [scheme("hamiltonian")], smoothing, 1.0 / rate, batch)
        self._instants = np.zeros((self.every + MARGIN, 4, batch))
        self._sum, self._count = np.zeros((2, batch))  # of torque over the bin to come, and its usable samples
        self._step = 0

    def reset(self, which: Mask) -> None:
        """What follows of those pendulums (B,) does not continue what came."""
        self._stream.reset(which)
        self._count[which] = 0

    def take(self, time: Array, position: Array, torque: Array) -> list[Bin]:
        """Take in a sample of each, as `OnlineEstimator.take`; returns the bins that are complete."""
        taken, ring = self._stream.take(time, position, torque), len(self._instants)
        self._instants[self._step % ring] = self._stream.following[[TIME, POSITION, VELOCITY, TORQUE]]
        self._sum += taken.y[:, 0]
        self._count += taken.usable[:, 0]
        self._step += 1
        if self._step % self.every:
            return []
        whole = np.flatnonzero((self._count == self.every) & (taken.place > self.every))
        mean = self._sum / self.every
        self._sum[:], self._count[:] = 0.0, 0
        if not len(whole):
            return []
        last = self._instants[(self._step + np.arange(ring)) % ring]  # (n + 3, 4, B)
        return [Bin(b, last[:, :, b].T.copy(), float(mean[b])) for b in whole.tolist()]
