"""Bins of motion: averages of a few samples, on which models are compared."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from estimators.online.arm_stream import make_stream
from estimators.online.rows import POSITION, TIME, TORQUE, VELOCITY
from estimators.online.stream import StreamEquations
from estimators.schemes.six import scheme
from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Mask
from pendulum_env.physics import Term

BIN = 0.01  # [s], averaging time: long against encoder noise, short against effects
BLOCK = 20  # bins in a block of gains
MARGIN = 3  # instants of a bin without a row: two before the first and one after the last


class Bin(NamedTuple):
    """Bin of one joint, with rows of the Hamiltonian scheme.

    Attributes:
        joint: index of the joint.
        series: time, position, velocity and torque at n + 3 instants (4, n + 3).
        phi: mean row of the terms (P,).
        y: mean torque minus the torque of terms without parameters [N m].
    """

    joint: int
    series: Array
    phi: Array
    y: float


class _JointBinner:
    """Current bin of one joint of B plants."""

    def __init__(self, every: int, columns: int, batch: int) -> None:
        self._every, self._instants = every, np.zeros((every + MARGIN, 4, batch))
        self._sum, self._count, self._step = np.zeros((batch, columns + 1)), np.zeros(batch), 0

    def reset(self, which: Mask) -> None:
        self._count[which] = 0

    def take(self, taken: StreamEquations) -> Iterator[tuple[int, Array, Array]]:
        """Add an equation of each plant; yield plant, series and mean equation (P + 1,) of complete bins."""
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
    """Collection of samples of B plants into bins; bins near stick are left out.

    Attributes:
        every: number of samples in a bin.
        joints: names of the joints of a plant; a pendulum has one joint without a name.
    """

    def __init__(self, rate: float, terms: Sequence[Term], smoothing: Smoothing, batch: int = 1) -> None:
        """Create a binner.

        Args:
            rate: sampling rate [Hz].
            terms: whose rows are averaged.
            smoothing: of the measurement.
            batch: number B of plants.
        """
        self.every = max(1, round(BIN * rate))
        self._stream = make_stream(terms, [scheme("hamiltonian")], smoothing, 1.0 / rate, batch)
        self.joints = self._stream.joints
        columns = sum(len(term.columns) for term in terms)
        self._joint_binners = [_JointBinner(self.every, columns, batch) for _ in self.joints]

    def reset(self, which: Mask) -> None:
        """Restart plants (B,) with their next sample."""
        self._stream.reset(which)
        for one in self._joint_binners:
            one.reset(which)

    def take(self, time: Array, position: Array, torque: Array) -> Iterator[tuple[int, Bin]]:
        """Add a sample of each plant, as `OnlineEstimator.take`; yield plants and their complete bins."""
        for taken in self._stream.take(time, position, torque):
            for b, series, mean in self._joint_binners[taken.joint].take(taken):
                yield b, Bin(taken.joint, series, mean[:-1], float(mean[-1]))
