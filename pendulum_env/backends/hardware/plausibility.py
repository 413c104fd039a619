"""Plausibility check of encoder readings under the commanded torque.

Of three readings, the change of the mean velocity from one span to the next is a mean of the acceleration between them,
weighted by a hat w that rises from the first to the middle one and falls to the last:

    (q2 - q1) / (t2 - t1) - (q1 - q0) / (t1 - t0) = int w q'' dt

and the same difference of any double integral is the same mean of what was integrated. So the law of motion, weighted
alike, holds for the angles that were read as they are, without a derivative:

    I int w q'' = int w tau - mgl int w sin q - b int w q' - fc int w sgn q'

Each parameter is known within a range only, dry friction at rest holds with anything up to fc, a command takes up to
`delay` to act, readings are uncertain by the time they took, and `slack` stands for all that is not in the law. What
lies outside of all of that, over any of a few spans, no arm in these ranges has done: the encoder or the drive fails,
or the arm is pushed. Short spans catch jumps at once, long ones what slack hides.
"""

import math
from bisect import bisect_right
from typing import NamedTuple

from pendulum_env.backends.hardware.config import PlantRanges


class Mark(NamedTuple):
    """Reading, and double integrals up to it, each per unit of its parameter [s^2]; those of torque in N m s^2."""

    position: float  # [rad]
    doubt: float  # [rad]
    least: float  # torque that may have acted, at least
    most: float  # and at most
    gravity: float  # of sin q
    angle: float  # of q': the integral of q [rad s]
    forward: float  # of 1 while the arm turns counter-clockwise for sure
    backward: float  # while it turns clockwise
    held: float  # while no verdict is possible


class PlausibilityCheck:
    """Check of the readings of the last half second against the possible motions of the arm."""

    spans = (0.004, 0.01, 0.025, 0.06, 0.15)  # [s], from the first reading to the middle one
    kept = 0.4  # [s] of readings: twice the longest span, and some
    batch = 256  # of readings that are forgotten at a time
    in_a_row = 2  # readings that cannot be: one alone may be a wrong time
    firm = 4.0  # standard deviations of a reading's time that count
    clock = 5e-5  # [s] by which any reading's time may be wrong
    slow = 0.02  # [rad/s], below which the arm may as well stick
    gain = 0.15  # share of a torque by which the motor's may differ

    def __init__(self, plant: PlantRanges, step: float, noise: float) -> None:
        """Take the ranges, the angle of a count [rad], and the uncertainty of a reading's time [s]."""
        self._watches, self._step, self._noise = plant.watch, abs(step), self.firm * noise + self.clock
        share = plant.share
        self._inertia = _widen_range(plant.inertia, share, share)
        self._gravity = _widen_range(plant.gravity, share, share)
        # viscous friction follows the temperature, and air adds to it
        self._viscous = _widen_range(plant.viscous, 4 * share, 3 * share)
        self._coulomb = _widen_range(plant.coulomb, 2 * share, share)
        self._slack, self._delay = plant.slack, plant.delay
        self.reset()

    def reset(self) -> None:
        """Forget the motion; no torque acts."""
        self._times: list[float] = []
        self._marks: list[Mark] = []
        self._slopes = [0.0] * 6  # first integrals, of all but the angle
        self._torques = [(-math.inf, 0.0, 0.0)]  # after which reading, and between what
        self._direction, self._start, self._wrong = 0, 0.0, 0

    def add_command(self, torque: float) -> None:
        """Add a torque [N m] that was sent after the last reading."""
        since = self._times[-1] if self._times else -math.inf
        least = most = torque
        if self._torques[-1][0] == since:
            _, least, most = self._torques.pop()
        self._torques.append((since, min(least, torque), max(most, torque)))

    def check_measurement(self, time: float, position: float, took: float = 0.0) -> str:
        """Return the problem of a position [rad] at a time [s], whose reading took `took` [s]; empty without one."""
        if not self._watches:
            return ""
        if not self._times:
            self._start = position
            self._times.append(time)
            self._marks.append(Mark(position, 2 * self._step, *[0.0] * 7))
            return ""
        passed = time - self._times[-1]
        if passed <= 0:
            return ""
        self._extend(time, position, passed, took)
        found = next(filter(None, map(self._find_impossible, self.spans)), "")
        self._wrong = self._wrong + 1 if found else 0
        if len(self._times) > 2 * self.batch and self._times[self.batch] < time - self.kept:
            del self._times[: self.batch], self._marks[: self.batch]
        return found if self._wrong >= self.in_a_row else ""

    def _extend(self, time: float, position: float, passed: float, took: float) -> None:
        """Integrate up to a reading."""
        last = self._marks[-1]
        moved, middle = position - last.position, 0.5 * (position + last.position)
        speed = abs(moved) / passed
        direction = int(math.copysign(1, moved)) if speed > self.slow + 2 * self._step / passed else 0
        same, self._direction = direction == self._direction, direction
        least, most = self._find_acting_torques(self._times[-1])
        rates = (
            least - self.gain * abs(least),
            most + self.gain * abs(most),
            math.sin(middle),
            float(same and direction > 0),
            float(same and direction < 0),
            float(not (same and direction)),
        )
        sums = (last.least, last.most, last.gravity, last.forward, last.backward, last.held)
        least, most, gravity, forward, backward, held = (
            double + passed * (slope + 0.5 * passed * rate)
            for double, slope, rate in zip(sums, self._slopes, rates, strict=True)
        )
        self._slopes = [slope + passed * rate for slope, rate in zip(self._slopes, rates, strict=True)]
        angle = last.angle + passed * (middle - self._start)
        doubt = 2 * self._step + speed * (self._noise + 0.5 * took)
        self._times.append(time)
        self._marks.append(Mark(position, doubt, least, most, gravity, angle, forward, backward, held))

    def _find_acting_torques(self, since: float) -> tuple[float, float]:
        """Return the least and the largest torque that may act after the reading of a time [s]."""
        torques = self._torques
        while len(torques) > 2 and torques[2][0] + self._delay <= since:  # the next one has reached the drive by then
            del torques[0]
        return min(least for _, least, _ in torques), max(most for _, _, most in torques)

    def _find_impossible(self, span: float) -> str:
        """Return the problem of the motion over two spans [s] up to now as text."""
        times, marks = self._times, self._marks
        end = times[-1]
        middle = bisect_right(times, end - span) - 1
        if middle < 1:
            return ""
        begin = bisect_right(times, times[middle] - (end - times[middle]) + 1e-9) - 1
        if begin < 0:
            return ""
        after, before = 1.0 / (end - times[middle]), 1.0 / (times[middle] - times[begin])
        both = after + before
        change, _, least, most, of_gravity, of_speed, forward, backward, unsure = (
            third * after - second * both + first * before
            for first, second, third in zip(marks[begin], marks[middle], marks[-1], strict=True)
        )  # change of velocity [rad/s], impulses [N m s], and per unit of a parameter [s]
        doubt = marks[-1].doubt * after + marks[middle].doubt * both + marks[begin].doubt * before
        gravity, viscous = _scale_range(self._gravity, of_gravity), _scale_range(self._viscous, of_speed)
        weak, strong = self._coulomb
        slack = self._slack * 0.5 * (end - times[begin]) + strong * unsure
        low = least - gravity[1] - viscous[1] - (strong * forward - weak * backward) - slack  # [N m s]
        high = most - gravity[0] - viscous[0] - (weak * forward - strong * backward) + slack
        light, heavy = self._inertia
        fastest, slowest = change + doubt, change - doubt
        if low <= max(fastest * light, fastest * heavy) and min(slowest * light, slowest * heavy) <= high:
            return ""
        return f"its speed changed by {change:.2g} rad/s within {1e3 / after:.0f} ms"


def _widen_range(value: float, less: float, more: float) -> tuple[float, float]:
    return value / (1.0 + less), value * (1.0 + more)


def _scale_range(known: tuple[float, float], factor: float) -> tuple[float, float]:
    """Scale the range of a parameter by a factor of any sign."""
    one, other = known[0] * factor, known[1] * factor
    return (one, other) if factor >= 0 else (other, one)
