"""A loop of fixed rate on the monotonic clock, and how well it was kept."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from typing import NamedTuple

NAP = 150e-6  # [s] before a tick from which the loop waits awake: a sleep may end that late


PRIORITY = 20  # of SCHED_FIFO: above all that is not real-time, below the kernel's own threads


def realtime() -> bool:
    """Ask the system to run this thread, and those it starts, as soon as they are ready; False if it does not."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):  # not Linux, or not permitted
        return False
    return True


def ordinary() -> None:
    """Give real-time priority back."""
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class Timing(NamedTuple):
    """How well the rate was kept."""

    jitter: float  # how late the last sample was taken after its tick [s]
    overruns: int  # ticks of this run that had passed already when their turn came


class Pacer:
    """Ticks at start + k * period. A tick that is missed is not left out but caught up with: ticks never drift."""

    def __init__(self, period: float) -> None:
        """Take the time between ticks [s]."""
        self.period = period

    def start(self, now: float) -> None:
        """The first tick is now [s]."""
        self._start, self.count, self.overruns = now, 0, 0

    @property
    def tick(self) -> float:
        """Time of the tick it is at [s]."""
        return self._start + self.count * self.period

    @property
    def time(self) -> float:
        """From the start to the tick it is at [s]."""
        return self.count * self.period

    def wait(self) -> None:
        """Go on to the next tick, and wait for it unless it has passed."""
        self.count += 1
        left = self.tick - time.monotonic()
        if left < -self.period:
            self.overruns += 1
        if left > NAP:
            time.sleep(left - NAP)
        while time.monotonic() < self.tick:
            pass
