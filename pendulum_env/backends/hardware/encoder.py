"""From the counts of an encoder to an angle."""

from __future__ import annotations

import math

from pendulum_env.backends.hardware.config import EncoderSettings

TURNOVER = 2**32  # of a counter


def difference(new: int, old: int) -> int:
    """Counts from one reading of a 32-bit counter to another, that may have rolled over between them.

    ((new - old + 2^31) mod 2^32) - 2^31, right for steps of less than 2^31 either way.
    """
    return (new - old + TURNOVER // 2) % TURNOVER - TURNOVER // 2


class Encoder:
    """Unwraps the counter and knows where zero is."""

    def __init__(self, settings: EncoderSettings) -> None:
        """Zero is where the counter stands at the first reading, or the count that the settings name."""
        self.step = settings.sign * 2 * math.pi / settings.counts  # [rad] per count
        self._zero = settings.zero
        self._last: int | None = None
        self._total = 0  # counts since zero

    def moved(self, counts: int) -> float:
        """How far the arm is from the last position [rad], without taking it in."""
        return 0.0 if self._last is None else self.step * difference(counts, self._last)

    def take(self, counts: int) -> float:
        """Position [rad], unwrapped."""
        last = (counts if self._zero is None else self._zero) if self._last is None else self._last
        self._total += difference(counts, last)
        self._last = counts
        return self.position

    @property
    def position(self) -> float:
        """Where the arm was last seen [rad], unwrapped."""
        return self.step * self._total
