"""Check encoder readings for plausibility under the commanded torque.

With three readings, the change of the mean velocity between the two spans is a weighted integral of the acceleration,
with a hat function w that rises from the first to the middle reading and falls to the last:

    (q2 - q1) / (t2 - t1) - (q1 - q0) / (t1 - t0) = int w q'' dt

The same difference of the double integral of any quantity is its integral with weight w. The law of motion, integrated
with weight w, holds for the angles without a derivative:

    I int w q'' = int w tau - mgl int w sin q - b int w q' - fc int w sgn q'

Each parameter has a range, dry friction at rest is any torque up to fc, a command acts after up to `delay`, readings
are uncertain by their duration, and `slack` bounds all other torques. If a change of velocity is outside the resulting
range over any of several spans, the encoder or the amplifier fails, or the pendulum is pushed. Short spans detect jumps
early; long spans detect small torques.
"""

import math
from bisect import bisect_right
from typing import NamedTuple

from pendulum_env.backends.hardware.config import PlantRanges


class IntegratedReading(NamedTuple):
    """Reading with double integrals up to it, per unit of each parameter [s^2]; of torque in N m s^2."""

    position: float  # [rad]
    uncertainty: float  # uncertainty of the position [rad]
    least_torque: float  # least torque that may have acted
    largest_torque: float  # largest torque that may have acted
    gravity: float  # sin q
    angle: float  # q': the integral of q [rad s]
    forward: float  # 1 during counter-clockwise motion
    backward: float  # 1 during clockwise motion
    undirected: float  # 1 while the direction is unknown


class PlausibilityCheck:
    """Check of recent readings against the possible motions of the pendulum."""

    spans = (0.004, 0.01, 0.025, 0.06, 0.15)  # [s], from the first to the middle reading
    history = 0.4  # [s], stored readings, more than twice the longest span
    batch = 256  # readings that are removed together
    min_failures = 2  # implausible readings in a row for a fault; a single one may have a wrong time
    noise_factor = 4.0  # standard deviations of a reading's time in its uncertainty
    clock_error = 5e-5  # [s], further uncertainty of a reading's time
    sticking_speed = 0.02  # [rad/s], speed below which the pendulum may stick
    torque_error = 0.15  # relative uncertainty of the motor's torque

    def __init__(self, plant: PlantRanges, step: float, noise: float) -> None:
        """Set the ranges, the angle of a count [rad], and the standard deviation of a reading's time [s]."""
        self._is_enabled, self._step, self._noise = plant.watch, abs(step), self.noise_factor * noise + self.clock_error
        share = plant.share
        self._inertia = _widen_range(plant.inertia, share, share)
        self._gravity = _widen_range(plant.gravity, share, share)
        # wider: viscous friction depends on temperature and includes air drag
        self._viscous = _widen_range(plant.viscous, 4 * share, 3 * share)
        self._coulomb = _widen_range(plant.coulomb, 2 * share, share)
        self._slack, self._delay = plant.slack, plant.delay
        self.reset()

    def reset(self) -> None:
        """Remove all readings and commands."""
        self._times: list[float] = []
        self._readings: list[IntegratedReading] = []
        self._slopes = [0.0] * 6  # first integrals, without that of the angle
        self._torques = [(-math.inf, 0.0, 0.0)]  # time of the previous reading [s], least and largest torque [N m]
        self._direction, self._start, self._n_failures = 0, 0.0, 0

    def add_command(self, torque: float) -> None:
        """Add a torque [N m] that was sent after the last reading."""
        start = self._times[-1] if self._times else -math.inf
        least = largest = torque
        if self._torques[-1][0] == start:
            _, least, largest = self._torques.pop()
        self._torques.append((start, min(least, torque), max(largest, torque)))

    def check_measurement(self, time: float, position: float, duration: float = 0.0) -> str:
        """Check a position [rad] at a time [s], read within `duration` [s]; return the fault, or an empty text."""
        if not self._is_enabled:
            return ""
        if not self._times:
            self._start = position
            self._times.append(time)
            self._readings.append(IntegratedReading(position, 2 * self._step, *[0.0] * 7))
            return ""
        step = time - self._times[-1]
        if step <= 0:
            return ""
        self._add_to_integrals(time, position, step, duration)
        fault = next(filter(None, map(self._find_impossible, self.spans)), "")
        self._n_failures = self._n_failures + 1 if fault else 0
        if len(self._times) > 2 * self.batch and self._times[self.batch] < time - self.history:
            del self._times[: self.batch], self._readings[: self.batch]
        return fault if self._n_failures >= self.min_failures else ""

    def _add_to_integrals(self, time: float, position: float, step: float, duration: float) -> None:
        """Extend the integrals to a reading."""
        previous = self._readings[-1]
        angle_step, middle = position - previous.position, 0.5 * (position + previous.position)
        speed = abs(angle_step) / step
        direction = int(math.copysign(1, angle_step)) if speed > self.sticking_speed + 2 * self._step / step else 0
        is_same, self._direction = direction == self._direction, direction
        least, largest = self._find_acting_torques(self._times[-1])
        rates = (
            least - self.torque_error * abs(least),
            largest + self.torque_error * abs(largest),
            math.sin(middle),
            float(is_same and direction > 0),
            float(is_same and direction < 0),
            float(not (is_same and direction)),
        )
        _, _, *torques_and_gravity, angle, forward, backward, undirected = previous
        sums = (*torques_and_gravity, forward, backward, undirected)
        least, largest, gravity, forward, backward, undirected = (
            double + step * (slope + 0.5 * step * rate)
            for double, slope, rate in zip(sums, self._slopes, rates, strict=True)
        )
        self._slopes = [slope + step * rate for slope, rate in zip(self._slopes, rates, strict=True)]
        angle += step * (middle - self._start)
        uncertainty = 2 * self._step + speed * (self._noise + 0.5 * duration)
        self._times.append(time)
        integrals = least, largest, gravity, angle, forward, backward, undirected
        self._readings.append(IntegratedReading(position, uncertainty, *integrals))

    def _find_acting_torques(self, time: float) -> tuple[float, float]:
        """Return the least and the largest torque that may act after the reading of a time [s]."""
        torques = self._torques
        while len(torques) > 2 and torques[2][0] + self._delay <= time:  # the second command already acts
            del torques[0]
        return min(least for _, least, _ in torques), max(largest for _, _, largest in torques)

    def _find_impossible(self, span: float) -> str:
        """Return the fault of the motion over the last two spans [s] as text, or an empty text."""
        times, readings = self._times, self._readings
        end = times[-1]
        middle = bisect_right(times, end - span) - 1
        if middle < 1:
            return ""
        begin = bisect_right(times, times[middle] - (end - times[middle]) + 1e-9) - 1
        if begin < 0:
            return ""
        weight_after, weight_before = 1.0 / (end - times[middle]), 1.0 / (times[middle] - times[begin])
        weight = weight_after + weight_before
        change, _, least, largest, of_gravity, of_speed, forward, backward, undirected = (
            third * weight_after - second * weight + first * weight_before
            for first, second, third in zip(readings[begin], readings[middle], readings[-1], strict=True)
        )  # change of velocity [rad/s], impulses [N m s], and per unit of a parameter [s]
        uncertainty = (
            readings[-1].uncertainty * weight_after
            + readings[middle].uncertainty * weight
            + readings[begin].uncertainty * weight_before
        )
        gravity, viscous = _scale_range(self._gravity, of_gravity), _scale_range(self._viscous, of_speed)
        weak, strong = self._coulomb
        slack = self._slack * 0.5 * (end - times[begin]) + strong * undirected
        low = least - gravity[1] - viscous[1] - (strong * forward - weak * backward) - slack  # [N m s]
        high = largest - gravity[0] - viscous[0] - (weak * forward - strong * backward) + slack
        light, heavy = self._inertia
        fastest, slowest = change + uncertainty, change - uncertainty
        if low <= max(fastest * light, fastest * heavy) and min(slowest * light, slowest * heavy) <= high:
            return ""
        return f"its speed changed by {change:.2g} rad/s within {1e3 / weight_after:.0f} ms"


def _widen_range(value: float, share_below: float, share_above: float) -> tuple[float, float]:
    return value / (1.0 + share_below), value * (1.0 + share_above)


def _scale_range(limits: tuple[float, float], factor: float) -> tuple[float, float]:
    """Scale a range by a factor of any sign."""
    low, high = limits[0] * factor, limits[1] * factor
    return (low, high) if factor >= 0 else (high, low)
