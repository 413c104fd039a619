"""When samples come: at the rate, after a gap, or off the rate, which no filter bears."""

import math

from pendulum_env.recording.sampling import SAMPLING


class Clock:
    """Refuses samples off the rate; once they have kept it, a longer time is a gap."""

    def __init__(self, rate: float) -> None:
        """Take the samples per second [Hz]."""
        self._rate, self._time, self._came = rate, -math.inf, False

    def restart(self) -> None:
        """Time starts anew."""
        self._time = -math.inf

    def tick(self, time: float) -> bool:
        """Take the time of a sample [s]; whether a gap lies before it.

        Raises:
            ValueError: if time does not go on, or more than a tenth of a period is missing or too much.
        """
        passed = time - self._time
        if passed <= 0:
            raise ValueError(
                f"a sample of {time:.6g} s comes after one of {self._time:.6g} s: reset where time begins anew"
            )
        on_time, follows = 0.9 < passed * self._rate < 1.1, math.isfinite(passed)
        gap = follows and not on_time
        if gap and not (self._came and passed * self._rate > SAMPLING.long):
            raise ValueError(f"samples come every {passed:.4g} s, not at {self._rate:g} Hz: pass rate=")
        self._time, self._came = time, self._came or on_time
        return gap


def checked_rate(rate: float) -> float:
    """A rate [Hz].

    Raises:
        ValueError: if it is no positive number.
    """
    if not 0 < rate < math.inf:
        raise ValueError(f"the rate cannot be {rate:g} Hz: give a positive number")
    return rate
