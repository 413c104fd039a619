"""Angle and torque at the ticks of a loop, from counts and clocks with varying delays.

The counts are read a little after each tick, and a new torque acts a little after it was asked for. At 10 rad/s, 0.1 ms
are 1 mrad, or 160 counts: taken for the value at the tick it would drown the encoder. So the time of a reading is told
by the drive's own clock where it has one, and the angle is interpolated to the tick.
"""

import math
import time
from collections import deque

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.config import EncoderSettings

TURNOVER = 2**32  # of a counter of encoder lines or of microseconds


def subtract_counts(new: int, old: int) -> int:
    """Subtract readings of a 32-bit counter that may have rolled over between them.

    ((new - old + 2^31) mod 2^32) - 2^31, right for steps of less than 2^31 either way.
    """
    return (new - old + TURNOVER // 2) % TURNOVER - TURNOVER // 2


class Encoder:
    """Encoder that unwraps the counter, with zero and velocity.

    Attributes:
        step: angle of a count [rad], negative if it counts down counter-clockwise.
        velocity: between the last two readings at least `span` apart [rad/s].
    """

    span = 2e-3  # [s], at least, between the readings whose difference is the velocity
    jump = 2.0  # times the largest velocity and more is no motion

    def __init__(self, settings: EncoderSettings, fastest: float = math.inf) -> None:
        """Set zero at the first reading or at the count of the settings; the arm turns at `fastest` at most [rad/s]."""
        self.step = settings.sign * 2 * math.pi / settings.counts
        self._fastest = fastest
        self._last = settings.zero  # count
        self._total = 0  # counts since zero
        self.forget()

    def forget(self) -> None:
        """Forget the motion, but keep the position."""
        self.velocity = 0.0
        self._since: tuple[float, float] | None = None  # time and position that velocity is taken from

    @property
    def position(self) -> float:
        """Return the last measured position of the arm [rad], unwrapped."""
        return self.step * self._total

    def take(self, time: float, counts: int) -> float | None:
        """Take in the counts at a time [s]; returns how far the arm has moved [rad] where that made a new velocity.

        Raises:
            DriveError: if no arm can have moved so far; the reading is not taken in.
        """
        total = self._total + (0 if self._last is None else subtract_counts(counts, self._last))
        position = self.step * total
        begin, start = self._since or (time, position)
        span, moved = max(time - begin, self.span), position - start
        if abs(moved) > self.jump * self._fastest * span + 10 * abs(self.step):
            raise DriveError(
                f"the encoder jumped by {moved:.3g} rad in {1e3 * span:.3g} ms: check its cable, shield and supply"
            )
        self._last, self._total, self._since = counts, total, (begin, start)
        if time - begin < self.span:
            return None
        self.velocity, self._since = moved / span, (time, position)
        return moved


class DriveClock:
    """Map from the microseconds of a drive to this computer's monotonic clock.

    A reading is taken between its request and its answer. The quicker the answer, the better is the middle of the two
    known, so the clocks are compared where it came as quickly as ever, as in the clock filter of NTP (RFC 5905).
    """

    drift = 100e-6  # by which two quartz clocks may run apart
    blend = 0.1  # of a new comparison, so that time makes no jumps

    def __init__(self) -> None:
        self._last: int | None = None
        self._time = self._offset = 0.0
        self._doubt = math.inf  # [s], half of what the quickest answer took, and more as the clocks run apart

    @property
    def delay(self) -> float:
        """Return the shortest time that a message takes one way [s]."""
        return self._doubt if self._doubt < math.inf else 0.0

    def take(self, microseconds: int, asked: float, answered: float) -> float:
        """Return the time [s] of a reading of the drive's clock between a request and its answer [s]."""
        passed = 0.0 if self._last is None else 1e-6 * ((microseconds - self._last) % TURNOVER)
        self._last = microseconds
        self._time += passed
        self._doubt += self.drift * passed
        doubt, offset = 0.5 * (answered - asked), 0.5 * (asked + answered) - self._time
        if doubt < self._doubt:
            near = abs(offset - self._offset) < self._doubt + doubt < math.inf
            self._offset += (self.blend if near else 1.0) * (offset - self._offset)
            self._doubt = doubt
        return min(max(self._time + self._offset, asked), answered)


class Ticks:
    """Ticks at start + k * period on the monotonic clock, position at each and mean torque between them.

    A tick that is missed is not left out but caught up with: ticks never drift. The angle at a tick is that of a
    parabola, whose error grows with the cube of the time between readings: at 1,000 rad/s^3 some 1e-7 rad for 1 ms,
    and 1e-4 rad where the loop was held up for 10 ms. In the torque each command has the share of the time it acted.
    """

    kept = 64  # readings before the tick
    nap = 150e-6  # [s] before a tick from which the loop waits awake: a sleep may end that late

    def __init__(self, period: float, start: float, position: float) -> None:
        """Start at rest at a position [rad] at the first tick [s], without torque; a period lies between ticks [s]."""
        self._period, self._start, self._count = period, start, 0
        self.overruns = 0  # ticks that had passed already, by a period, when their turn came
        self._readings = deque([(start, position)])
        self._commands = deque([(start, 0.0)])  # each acts until the next; the first acts at the last tick

    @property
    def now(self) -> float:
        """Return the current tick on the monotonic clock [s]."""
        return self._start + self.time

    @property
    def time(self) -> float:
        """Return the current tick, counted from the first one [s]."""
        return self._count * self._period

    def wait(self) -> None:
        """Go on to the next tick, and wait for it unless it has passed."""
        self._count += 1
        left = self.now - time.monotonic()
        self.overruns += left < -self._period
        if left > self.nap:
            time.sleep(left - self.nap)
        while time.monotonic() < self.now:
            pass

    def add_command(self, time: float, torque: float) -> None:
        """Add a torque [N m] that acts from a time [s] on."""
        self._commands.append((max(time, self._commands[-1][0]), torque))

    def add_measurement(self, time: float, position: float) -> None:
        """Add a position [rad] at a time [s]."""
        if time > self._readings[-1][0]:
            self._readings.append((time, position))

    @property
    def position(self) -> float:
        """Return the position at the tick [rad]: the parabola through the readings around it and an older one.

        The older one is as far away as these two are from each other, or the noise of the three would grow.
        """
        readings, tick = self._readings, self.now
        while len(readings) > self.kept and readings[self.kept][0] < tick:
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
        """Return the mean torque over the period that ends with the tick [N m]; forget older commands."""
        begin, end, impulse = self.now - self._period, self.now, 0.0
        while True:
            since, torque = self._commands[0]
            until = self._commands[1][0] if len(self._commands) > 1 else end
            impulse += torque * max(0.0, min(until, end) - max(since, begin))
            if until >= end:
                return impulse / self._period
            self._commands.popleft()
