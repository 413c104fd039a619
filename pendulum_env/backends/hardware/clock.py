"""The clock of a drive, told in the time of this computer."""

from __future__ import annotations

TURNOVER = 2**32  # of a clock that counts microseconds
DRIFT = 200e-6  # by which two quartz clocks may run apart


class DriveClock:
    """Maps the microseconds of a drive to this computer's monotonic clock.

    A reading says when it was taken and arrives later, by a delay that varies; the smallest seen is taken to be none.
    So what varies is not the time of the samples but only how late they come to be known.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def take(self, microseconds: int, arrived: float) -> float:
        """Time [s] at which the drive's clock showed that, for a reading that arrived at a time [s]."""
        if self._last is None:
            self._time, self._offset, self._last = 0.0, arrived, microseconds
        passed = 1e-6 * ((microseconds - self._last) % TURNOVER)
        self._last = microseconds
        self._time += passed
        self._offset = min(self._offset + DRIFT * passed, arrived - self._time)
        return self._time + self._offset
