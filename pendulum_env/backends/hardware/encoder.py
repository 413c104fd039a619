"""Angle and torque at the ticks of a loop, from readings and commands with varying delays.

Counts are read shortly after each tick, and a torque acts shortly after its command. At 10 rad/s, a delay of 0.1 ms is
an error of 1 mrad or 160 counts. Therefore the time of a reading comes from the device's clock, if it has one, and the
angle is interpolated to the tick.
"""

import math
import time
from collections import deque

from pendulum_env.backends.hardware import DriveError
from pendulum_env.backends.hardware.config import EncoderSettings

TURNOVER = 2**32  # range of the counters of counts and microseconds


def subtract_counts(counts: int, previous: int) -> int:
    """Subtract readings of a 32-bit counter, which may have rolled over between them.

    ((new - old + 2^31) mod 2^32) - 2^31, exact for differences below 2^31 of either sign.
    """
    return (counts - previous + TURNOVER // 2) % TURNOVER - TURNOVER // 2


class Encoder:
    """Encoder with unwrapped position and velocity.

    Attributes:
        step: angle of a count [rad], negative if counter-clockwise turns count down.
        velocity: mean velocity between the last two readings at least `span` apart [rad/s].
    """

    span = 2e-3  # [s], least time between the readings of a velocity
    max_jump = 2.0  # ratio to the largest velocity above which a reading is wrong

    def __init__(self, settings: EncoderSettings, max_speed: float = math.inf) -> None:
        """Set zero to the count of the settings, by default the first reading, and the largest speed [rad/s]."""
        self.step = settings.sign * 2 * math.pi / settings.counts
        self._max_speed = max_speed
        self._last = settings.zero  # count
        self._total = 0  # counts since zero
        self.reset_velocity()

    def reset_velocity(self) -> None:
        """Reset the velocity and keep the position."""
        self.velocity = 0.0
        self._velocity_start: tuple[float, float] | None = None  # time [s] and position [rad] of its first reading

    @property
    def position(self) -> float:
        """Return the last measured position of the pendulum [rad], unwrapped."""
        return self.step * self._total

    def add_reading(self, time: float, counts: int) -> float | None:
        """Add a reading of counts at a time [s].

        Returns:
            Angle since the last update of the velocity [rad], or None if the velocity was not updated.

        Raises:
            DriveError: if the angle is impossible; the reading is then discarded.
        """
        total = self._total + (0 if self._last is None else subtract_counts(counts, self._last))
        position = self.step * total
        begin, start = self._velocity_start or (time, position)
        span, angle = max(time - begin, self.span), position - start
        if abs(angle) > self.max_jump * self._max_speed * span + 10 * abs(self.step):
            raise DriveError(
                f"the encoder jumped by {angle:.3g} rad in {1e3 * span:.3g} ms: check its cable, shield and supply"
            )
        self._last, self._total, self._velocity_start = counts, total, (begin, start)
        if time - begin < self.span:
            return None
        self.velocity, self._velocity_start = angle / span, (time, position)
        return angle


class DeviceClock:
    """Map from the microseconds of a device to this computer's monotonic clock.

    A reading is taken between its request and its answer, with half of this time as its uncertainty. Clocks are
    therefore compared at the quickest answers, as in the clock filter of NTP (RFC 5905).
    """

    drift = 100e-6  # largest relative drift of two quartz clocks
    blend = 0.1  # weight of a new comparison, which avoids jumps

    def __init__(self) -> None:
        self._last: int | None = None
        self._time = self._offset = 0.0
        self._uncertainty = math.inf  # [s], uncertainty of the offset: half of the quickest answer's time, plus drift

    @property
    def delay(self) -> float:
        """Return the shortest one-way delay of a message [s]."""
        return self._uncertainty if self._uncertainty < math.inf else 0.0

    def convert_time(self, microseconds: int, request_time: float, answer_time: float) -> float:
        """Return the monotonic time [s] of a reading of the device's clock, between request and answer [s]."""
        elapsed = 0.0 if self._last is None else 1e-6 * ((microseconds - self._last) % TURNOVER)
        self._last = microseconds
        self._time += elapsed
        self._uncertainty += self.drift * elapsed
        uncertainty, offset = 0.5 * (answer_time - request_time), 0.5 * (request_time + answer_time) - self._time
        if uncertainty < self._uncertainty:
            is_near = abs(offset - self._offset) < self._uncertainty + uncertainty < math.inf
            self._offset += (self.blend if is_near else 1.0) * (offset - self._offset)
            self._uncertainty = uncertainty
        return min(max(self._time + self._offset, request_time), answer_time)


class Ticks:
    """Ticks at start + k * period on the monotonic clock, with the position at each and the mean torque between.

    Missed ticks are caught up, so ticks do not drift. The angle at a tick is interpolated by a parabola. Its error
    grows with the cube of the time between readings: at 1,000 rad/s^3, 1e-7 rad for 1 ms and 1e-4 rad for 10 ms. The
    mean torque weights each command by its duration.
    """

    max_readings = 64  # stored readings before the tick
    busy_wait = 150e-6  # [s], busy wait before a tick, longer than the delay of a sleep

    def __init__(self, period: float, start: float, position: float) -> None:
        """Set period [s], time of the first tick [s] and position at rest [rad], without torque."""
        self._period, self._start, self._count = period, start, 0
        self.overruns = 0  # ticks that were missed by a period or more
        self._readings = deque([(start, position)])
        self._commands = deque([(start, 0.0)])  # time [s] and torque [N m]; each acts until the next one

    @property
    def tick_time(self) -> float:
        """Return the current tick on the monotonic clock [s]."""
        return self._start + self.time

    @property
    def time(self) -> float:
        """Return the current tick, counted from the first one [s]."""
        return self._count * self._period

    def wait(self) -> None:
        """Advance to the next tick and wait until its time."""
        self._count += 1
        remaining = self.tick_time - time.monotonic()
        self.overruns += remaining < -self._period
        if remaining > self.busy_wait:
            time.sleep(remaining - self.busy_wait)
        while time.monotonic() < self.tick_time:
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
        """Return the position at the tick [rad], by a parabola through the two readings around it and an older one.

        The older reading is at least as far away as the two are apart, which limits the noise.
        """
        readings, tick = self._readings, self.tick_time
        while len(readings) > self.max_readings and readings[self.max_readings][0] < tick:
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
        """Return the mean torque over the period that ends with the tick [N m]; remove older commands."""
        begin, end, impulse = self.tick_time - self._period, self.tick_time, 0.0
        while True:
            since, torque = self._commands[0]
            until = self._commands[1][0] if len(self._commands) > 1 else end
            impulse += torque * max(0.0, min(until, end) - max(since, begin))
            if until >= end:
                return impulse / self._period
            self._commands.popleft()
