"""What a rig measured at uneven times, referred to the ticks of its loop.

The counts are read a little after each tick, and a new torque acts a little after it was asked for. At 10 rad/s, 0.1 ms
are 1 mrad, or 160 counts: taken for the value at the tick it would drown the encoder. So the angle is interpolated to
the tick, by a parabola: its error grows with the cube of the time between readings, at 1,000 rad/s^3 to some 1e-7 rad
for 1 ms, and 1e-4 rad where the loop was held up for 10 ms. Of the torque the mean over the period counts, in which
each command has the share of the time that it acted.
"""

from __future__ import annotations

from collections import deque

KEPT = 64  # readings before the tick


class Ticks:
    """Position at the ticks and mean torque between them."""

    def __init__(self, tick: float, position: float) -> None:
        """The arm rests at a position [rad] at the first tick [s], without torque."""
        self._tick = tick
        self._readings = deque([(tick, position)])
        self._commands = deque([(tick, 0.0)])  # each acts until the next; the first acts at the last tick

    def commanded(self, time: float, torque: float) -> None:
        """A torque [N m] acts from a time [s] on."""
        self._commands.append((max(time, self._commands[-1][0]), torque))

    def measured(self, time: float, position: float) -> None:
        """The arm was at a position [rad] at a time [s]."""
        if time > self._readings[-1][0]:
            self._readings.append((time, position))

    def advance(self, tick: float) -> tuple[float, float]:
        """Position [rad] at the next tick [s], and mean torque [N m] over the period that ends with it."""
        mean = self._impulse(tick) / (tick - self._tick)
        self._tick = tick
        return self._position(tick), mean

    def _position(self, tick: float) -> float:
        """Newton's form of the parabola through the readings around the tick and an older one.

        The older one is as far away as these two are from each other, or the noise of the three would grow.
        """
        readings = self._readings
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

    def _impulse(self, tick: float) -> float:
        """Of the commands since the last tick [N m s]; forgets those that have had their time."""
        impulse = 0.0
        while True:
            begins, torque = self._commands[0]
            ends = self._commands[1][0] if len(self._commands) > 1 else tick
            impulse += torque * max(0.0, min(ends, tick) - max(begins, self._tick))
            if ends >= tick:
                return impulse
            self._commands.popleft()
