"""Samples of many pendulums, gathered in bins of motion: what models are compared on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from estimators.online.rows import POSITION, TIME, TORQUE, VELOCITY
from estimators.online.stream import Stream, Taken
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
        of: which of the B plants.
        joint: which of its joints.
        series: time, position, velocity and torque at its n + 3 instants (4, n + 3).
        phi: mean row of the terms (P,).
        y: mean torque over it, less that of what has no parameter [N m].
        moved: time that the plant has been in motion, stick and turns included, since it began [s].
    """

    of: int
    joint: int
    series: Array
    phi: Array
    y: float
    moved: float


class BinSource(Protocol):
    """What gathers samples of B plants in bins; those in which a joint sticks, or almost, are left out.

    Attributes:
        every: samples in a bin.
        joints: names of a plant's joints; one of no name is a pendulum's.
    """

    every: int
    joints: tuple[str, ...]

    def reset(self, which: Mask) -> None:
        """What follows of those plants (B,) does not continue what came."""

    def take(self, time: Array, position: Array, torque: Array) -> list[Bin]:
        """Take in a sample of each, as `OnlineEstimator.take`; returns the bins that are complete."""


class Binner(BinSource):
    """Gathers samples of B pendulums.

    Attributes:
        delay: of the equations [samples].
        taken: the newest equations.
    """

    taken: Taken
    joints = ("",)

    def __init__(self, rate: float, smoothing: Smoothing, batch: int, terms: Sequence[Term] = ()) -> None:
        """Take the samples per second [Hz], the smoothing of the measurement, B, and terms whose rows are wanted."""
        self.every, self._rate, self._slowest = max(1, round(BIN * rate)), rate, smoothing.slowest
        self._stream = Stream(terms, [scheme("hamiltonian")], smoothing, 1.0 / rate, batch)
        self.delay = self._stream.delay
        self._instants = np.zeros((self.every + MARGIN, 4, batch))
        self._sum = np.zeros((batch, sum(len(term.columns) for term in terms) + 1))  # over the bin to come
        self._count, self._moved = np.zeros((2, batch))  # its usable samples, and those in motion so far
        self._step = 0

    def reset(self, which: Mask) -> None:
        """What follows of those pendulums (B,) does not continue what came."""
        self._stream.reset(which)
        self._count[which] = self._moved[which] = 0

    @property
    def velocity(self) -> Array:
        """At the newest equations (B,) [rad/s]."""
        return self._stream.instant[VELOCITY]

    def take(self, time: Array, position: Array, torque: Array) -> list[Bin]:
        """Take in a sample of each, as `OnlineEstimator.take`; returns the bins that are complete."""
        self.taken = taken = self._stream.take(time, position, torque)
        ring = len(self._instants)
        self._instants[self._step % ring] = self._stream.following[[TIME, POSITION, VELOCITY, TORQUE]]
        self._moved += np.abs(self.velocity) > self._slowest
        self._sum += np.where(taken.usable, taken.equations[:, 0], 0.0)
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
        return [
            Bin(b, 0, last[:, :, b].T.copy(), mean[b, :-1], float(mean[b, -1]), self._moved[b] / self._rate)
            for b in whole.tolist()
        ]


class Monitor(Protocol):
    """What takes in the bins of one plant, and says what it makes of them."""

    @property
    def said(self) -> Any:
        """The verdict."""

    def reset(self) -> None:
        """Nothing is known yet."""

    def take(self, one: Bin) -> None:
        """Take in a bin of motion."""


M = TypeVar("M", bound=Monitor)


class Monitors(Generic[M]):
    """Monitors of B pendulums, or of an arm, which take in one sample of each per step.

    Attributes:
        each: monitors, one a plant.
        rate: samples per second [Hz].
        batch: number B of plants.
    """

    def __init__(self, rate: float, binner: BinSource, each: Sequence[M]) -> None:
        """Take the rate, what gathers samples in bins, and the monitors."""
        self.rate, self.batch, self.each = rate, len(each), tuple(each)
        self._binner = binner

    @property
    def said(self) -> tuple[Any, ...]:
        """What is said of each."""
        return tuple(one.said for one in self.each)

    def reset(self, which: Mask | None = None) -> None:
        """Those plants (B,) start anew with the next sample; all without an argument."""
        mask = np.ones(self.batch, dtype=bool) if which is None else which
        self._binner.reset(mask)
        for b in np.flatnonzero(mask):
            self.each[b].reset()

    def take(self, time: Array, position: Array, torque: Array) -> tuple[Any, ...]:
        """Take in a sample of every plant, as `OnlineEstimator.take`; returns what is said of each."""
        for one in self._binner.take(time, position, torque):
            self.each[one.of].take(one)
        return self.said
