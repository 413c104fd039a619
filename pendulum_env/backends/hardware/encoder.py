"""From the counts of an encoder to angle and velocity."""

from __future__ import annotations

import math

from pendulum_env.backends.hardware.config import EncoderSettings
from pendulum_env.backends.hardware.drive import DriveError

TURNOVER = 2**32  # of a counter
SPAN = 2e-3  # [s], at least, between the readings whose difference is the velocity
JUMP = 2.0  # times the largest velocity and more is no motion


def difference(new: int, old: int) -> int:
    """Counts from one reading of a 32-bit counter to another, that may have rolled over between them.

    ((new - old + 2^31) mod 2^32) - 2^31, right for steps of less than 2^31 either way.
    """
    return (new - old + TURNOVER // 2) % TURNOVER - TURNOVER // 2


class Encoder:
    """Unwraps the counter, and knows where zero is and how fast the arm turns.

    Attributes:
        step: angle of a count [rad], negative if it counts down counter-clockwise.
        velocity: between the last two readings at least `SPAN` apart [rad/s].
    """

    def __init__(self, settings: EncoderSettings, fastest: float = math.inf) -> None:
        """Zero is where the counter stands at the first reading, or the count that the settings name.

        An arm turns at `fastest` at most [rad/s].
        """
        self.step = settings.sign * 2 * math.pi / settings.counts
        self._fastest = fastest
        self._last = settings.zero  # count
        self._total = 0  # counts since zero
        self.forget()

    def forget(self) -> None:
        """Nothing is known of the motion, but where the arm is."""
        self.velocity = 0.0
        self._since: tuple[float, float] | None = None  # time and position that velocity is taken from

    @property
    def position(self) -> float:
        """Where the arm was last seen [rad], unwrapped."""
        return self.step * self._total

    def take(self, time: float, counts: int) -> float | None:
        """Take in the counts at a time [s]; returns how far the arm has moved [rad] where that made a new velocity.

        Raises:
            DriveError: if no arm can have moved so far; the reading is not taken in.
        """
        total = self._total + (0 if self._last is None else difference(counts, self._last))
        position, since = self.step * total, self._since
        begin, start = since or (time, position)
        span, moved = max(time - begin, SPAN), position - start
        if abs(moved) > JUMP * self._fastest * span + 10 * abs(self.step):
            raise DriveError(
                f"the encoder jumped by {moved:.3g} rad in {1e3 * span:.3g} ms: check its cable, shield and supply"
            )
        self._last, self._total = counts, total
        if since is None:
            self._since = time, position
        if since is None or time - begin < SPAN:
            return None
        self.velocity, self._since = moved / span, (time, position)
        return moved
