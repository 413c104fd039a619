"""Real-time priority, for a loop that has to keep time beside other programs."""

from __future__ import annotations

import os
from contextlib import suppress

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
