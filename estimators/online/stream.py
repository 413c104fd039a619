"""Measurements sample by sample: what `measure` makes of a whole recording, as soon as it can be known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.signals.measurements import Smoothing
from pendulum_env._typing import Array, Index, Mask
from pendulum_env.recording.sampling import LONG


@dataclass(frozen=True, eq=False)
class Instant:
    """One sample of B pendulums, `reach` samples ago; the fields are those of `Measurements`, each (B,).

    index counts the samples of each pendulum since it was reset and is negative while too few have come in.
    """

    index: Index
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    held: Array


class Stream:
    """The filter of `measure`, fed with one sample of B pendulums after the other."""

    def __init__(self, smoothing: Smoothing, period: float, batch: int) -> None:
        """Take the filter, the time between samples [s] and the number of pendulums B."""
        self._delay, self._longest = smoothing.reach * period, LONG * period
        self._length = 2 * smoothing.reach + 1
        # oldest sample first; the newest torque that is known is the one that acted until the newest position
        self._value = np.ascontiguousarray(smoothing.of_position()[::-1])  # (W,)
        self._steps = np.ascontiguousarray(smoothing.of_steps(period)[:, ::-1])  # (2, W - 1)
        self._torque = np.ascontiguousarray(smoothing.of_torque()[:, :0:-1])  # (2, W - 1)
        # every sample is written twice, so that the last W of them always lie in a row
        self._position, self._moved, self._command = np.zeros((3, 2 * self._length, batch))
        self._last = np.zeros(batch)
        self._time = np.full(batch, np.inf)
        self._step = 0
        self._index = np.full(batch, -self._length, dtype=np.intp)

    def reset(self, which: Mask) -> None:
        """Those pendulums (B,) start anew with the next sample."""
        self._index[which] = -self._length

    def sound(self, time: Array, position: Array, torque: Array) -> tuple[Mask, tuple[Array, Array, Array]]:
        """Which pendulums (B,) have to start anew before a sample is taken in, and the sample, (B,) each.

        They do where it is not a number, which then is zero, and after a gap: as in a recording, nothing is told across
        it, and a segment begins.
        """
        lost = ~np.isfinite(time + position + torque)
        anew = lost | (time - self._time > self._longest)
        if not lost.any():
            return anew, (time, position, torque)
        return anew, (np.where(lost, 0.0, time), np.where(lost, 0.0, position), np.where(lost, 0.0, torque))

    def take(self, time: Array, position: Array, torque: Array) -> Instant:
        """Take in a sample: time [s], position [rad], and torque [N m] over the period that ends with it, (B,) each."""
        length, slot = self._length, self._step % self._length
        self._position[slot] = self._position[slot + length] = position
        self._moved[slot] = self._moved[slot + length] = position - self._last
        self._last, self._time = position, time
        self._command[slot] = self._command[slot + length] = torque
        self._step += 1
        self._index += 1
        q = self._value @ self._position[slot + 1 : slot + 1 + length]
        v, a = self._steps @ self._moved[slot + 2 : slot + 1 + length]
        at_instant, held = self._torque @ self._command[slot + 2 : slot + 1 + length]
        return Instant(self._index.copy(), time - self._delay, q, v, a, at_instant, held)
