"""The clock of a drive, told in the time of this computer."""

from __future__ import annotations

import math

TURNOVER = 2**32  # of a clock that counts microseconds
DRIFT = 100e-6  # by which two quartz clocks may run apart
BLEND = 0.1  # of a new comparison, so that time makes no jumps


class DriveClock:
    """Maps the microseconds of a drive to this computer's monotonic clock.

    A reading is taken between its request and its answer. The quicker the answer, the better is the middle of the two
    known, so the clocks are compared where it came as quickly as ever, as in the clock filter of NTP (RFC 5905).
    """

    def __init__(self) -> None:
        self._last: int | None = None
        self._time = self._offset = 0.0
        self._doubt = math.inf  # [s], half of what the quickest answer took, and more as the clocks run apart

    @property
    def delay(self) -> float:
        """Time that a message takes one way, at best [s]."""
        return self._doubt if self._doubt < math.inf else 0.0

    def take(self, microseconds: int, asked: float, answered: float) -> float:
        """Time [s] at which the drive's clock showed that, between a request and its answer [s]."""
        passed = 0.0 if self._last is None else 1e-6 * ((microseconds - self._last) % TURNOVER)
        self._last = microseconds
        self._time += passed
        self._doubt += DRIFT * passed
        doubt, offset = 0.5 * (answered - asked), 0.5 * (asked + answered) - self._time
        if doubt < self._doubt:
            near = abs(offset - self._offset) < self._doubt + doubt < math.inf
            self._offset += (BLEND if near else 1.0) * (offset - self._offset)
            self._doubt = doubt
        return min(max(self._time + self._offset, asked), answered)
