"""The ticks of a rig's loop, and what was measured at uneven times, referred to them.

The counts are read a little after each tick, and a new torque acts a little after it was asked for. At 10 rad/s, 0.1 ms
are 1 mrad, or 160 counts: taken for the value at the tick it would drown the encoder. So the angle is interpolated to
the tick, by a parabola: its error grows with the cube of the time between readings, at 1,000 rad/s^3 to some 1e-7 rad
for 1 ms, and 1e-4 rad where the loop was held up for 10 ms. Of the torque the mean over the period counts, in which
each command has the share of the time that it acted.
"""

from __future__ import annotations

import time
from collections import deque

KEPT = 64  # readings before the tick
NAP = 150e-6  # [s] before a tick from which the loop waits awake: a sleep may end that late


class Ticks:
    """Ticks at start + k * period on the monotonic clock, position at each and mean torque between them.

    A tick that is missed is not left out but caught up with: ticks never drift.
    """

    def __init__(self, period: float, start: float, position: float) -> None:
        """The arm rests at a position [rad] at the first tick [s], without torque; a period lies between ticks [s]."""
        self._period, self._start, self._count = period, start, 0
        self.overruns = 0  # ticks that had passed already, by a period, when their turn came
        self._readings = deque([(start, position)])
        self._commands = deque([(start, 0.0)])  # each acts until the next; the first acts at the last tick

    @property
    def now(self) -> float:
        """The tick that it is at, on the monotonic clock [s]."""
        return self._start + self.time

    @property
    def time(self) -> float:
        """The tick that it is at, since the first one [s]."""
        return self._count * self._period

    def wait(self) -> None:
        """Go on to the next tick, and wait for it unless it has passed."""
        self._count += 1
        left = self.now - time.monotonic()
        if left < -self._period:
            self.overruns += 1
        if left > NAP:
            time.sleep(left - NAP)
        while time.monotonic() < self.now:
            pass

    def commanded(self, time: float, torque: float) -> None:
        """A torque [N m] acts from a time [s] on."""
        self._commands.append((max(time, self._commands[-1][0]), torque))

    def measured(self, time: float, position: float) -> None:
        """The arm was at a position [rad] at a time [s]."""
        if time > self._readings[-1][0]:
            self._readings.append((time, position))

    @property
    def position(self) -> float:
        """At the tick [rad]: Newton's form of the parabola through the readings around it and an older one.

        The older one is as far away as these two are from each other, or the noise of the three would grow.
        """
        readings, tick = self._readings, self.now
        while len(readings) > KEPT and readings[KEPT][0] < tick:
            readings.popleft()
        if len(readings) == 1:
            return readings[0][1]
        k = len(readings) - 1
        while k > 1 and readings[k - 1][0] > tick:
            k -= 1
        (t1, q1), (t2, q2) = readings[k - 1], readings[k]
        slope = (q2 - q1) / (t2 - t1)
        position = q1 + slope * (tick - t1)
        for j in range(k - 2, -1, -1):
            t0, q0 = readings[j]
            if t1 - t0 >= t2 - t1:
                curvature = (slope - (q1 - q0) / (t1 - t0)) / (t2 - t0)
                return position + curvature * (tick - t1) * (tick - t2)
        return position

    def torque(self) -> float:
        """Mean over the period that ends with the tick [N m]; forgets the commands that have had their time."""
        begin, end, impulse = self.now - self._period, self.now, 0.0
        while True:
            since, torque = self._commands[0]
            until = self._commands[1][0] if len(self._commands) > 1 else end
            impulse += torque * max(0.0, min(until, end) - max(since, begin))
            if until >= end:
                return impulse / self._period
            self._commands.popleft()
