"""Samples of many plants, gathered in bins of motion: what models are compared on."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from estimators.online.arm_stream import stream_of
from estimators.online.rows import POSITION, TIME, TORQUE, VELOCITY
from estimators.online.stream import Taken
from estimators.schemes.six import scheme
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term

BIN = 0.01  # [s], over which rows are averaged: noise of the encoder averages out, effects do not
BLOCK = 20  # bins, over which gains are summed
MARGIN = 3  # instants of a bin beyond its rows: two before the first and one after the last


class Bin(NamedTuple):
    """A bin of one joint, its rows those of the Hamiltonian scheme.

    Attributes:
        joint: which of the plant's joints.
        series: time, position, velocity and torque at its n + 3 instants (4, n + 3).
        phi: mean row of the terms (P,).
        y: mean torque over it, less that of what has no parameter [N m].
    """

    joint: int
    series: Array
    phi: Array
    y: float


class _Gathered:
    """The bin to come of one joint of B plants."""

    def __init__(self, every: int, columns: int, batch: int) -> None:
        self._every, self._instants = every, np.zeros((every + MARGIN, 4, batch))
        self._sum, self._count, self._step = np.zeros((batch, columns + 1)), np.zeros(batch), 0

    def reset(self, which: Mask) -> None:
        self._count[which] = 0

    def take(self, taken: Taken) -> Iterator[tuple[int, Array, Array]]:
        """Take in an equation each; returns plant, series and mean equation (P + 1,) of bins that are complete."""
        ring, every = len(self._instants), self._every
        self._instants[self._step % ring] = taken.following[[TIME, POSITION, VELOCITY, TORQUE]]
        self._sum += np.where(taken.usable, taken.equations[:, 0], 0.0)
        self._count += taken.usable[:, 0]
        self._step += 1
        if self._step % every:
            return
        whole, mean = (self._count == every) & (taken.place > every), self._sum / every
        self._sum[:], self._count[:] = 0.0, 0
        if whole.any():
            last = self._instants[(self._step + np.arange(ring)) % ring]  # (n + 3, 4, B)
            for b in np.flatnonzero(whole).tolist():
                yield b, last[:, :, b].T.copy(), mean[b]


class Binner:
    """Gathers samples of B plants in bins; those in which a joint sticks, or almost, are left out.

    Attributes:
        every: samples in a bin.
        joints: names of a plant's joints; one of no name is a pendulum's.
    """

    def __init__(self, rate: float, terms: Sequence[Term], smoothing: Smoothing, batch: int = 1) -> None:
        """Take the samples per second [Hz], terms whose rows are wanted, the smoothing of the measurement, and B."""
        self.every = max(1, round(BIN * rate))
        self._stream = stream_of(terms, [scheme("hamiltonian")], smoothing, 1.0 / rate, batch)
        self.joints = self._stream.joints
        columns = sum(len(term.columns) for term in terms)
        self._each = [_Gathered(self.every, columns, batch) for _ in self.joints]

    def reset(self, which: Mask) -> None:
        """What follows of those plants (B,) does not continue what came."""
        self._stream.reset(which)
        for one in self._each:
            one.reset(which)

    def take(self, time: Array, position: Array, torque: Array) -> Iterator[tuple[int, Bin]]:
        """Take in a sample of each, as `OnlineEstimator.take`; tells plants and their bins that are over."""
        for taken in self._stream.take(time, position, torque):
            for b, series, mean in self._each[taken.joint].take(taken):
                yield b, Bin(taken.joint, series, mean[:-1], float(mean[-1]))
