"""Check of sample times: at the rate, after a gap, or off the rate."""

import math

from pendulum_env.recording.sampling import SAMPLING


class Clock:
    """Check of sample times against a rate; after the first samples at the rate, a longer time is a gap.

    Attributes:
        time: of the last sample [s]; minus infinity before the first.
    """

    def __init__(self, rate: float) -> None:
        """Create a clock with a rate [Hz]."""
        self._rate, self.time, self._came = rate, -math.inf, False

    def restart(self) -> None:
        """Accept any time next."""
        self.time = -math.inf

    def tick(self, time: float) -> bool:
        """Check the time of a sample [s], and return whether a gap lies before it.

        Raises:
            ValueError: if time does not increase, or differs by more than a tenth of a period from the rate.
        """
        passed = time - self.time
        if passed <= 0:
            raise ValueError(
                f"a sample at {time:.6g} s follows one at {self.time:.6g} s: call reset where time restarts"
            )
        on_time, follows = 0.9 < passed * self._rate < 1.1, math.isfinite(passed)
        gap = follows and not on_time
        if gap and not (self._came and passed * self._rate > SAMPLING.long):
            raise ValueError(f"samples come every {passed:.4g} s, not at {self._rate:g} Hz: pass rate=")
        self.time, self._came = time, self._came or on_time
        return gap


def check_rate(rate: float) -> float:
    """Return a rate [Hz].

    Raises:
        ValueError: if it is not positive and finite.
    """
    if not 0 < rate < math.inf:
        raise ValueError(f"the rate cannot be {rate:g} Hz: give a positive number")
    return rate
