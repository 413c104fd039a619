"""Time of recordings on one clock, as of one log in several files."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from estimators.data.preparation import Recordings
from pendulum_env.recording import Recording


def share_clock(recordings: Sequence[Recording]) -> Recordings:
    """Return recordings with time from the first sample of all, if their clock runs on; else the same recordings.

    The clock runs on if each recording begins at the end of the one before or later, by at most its duration.
    """
    if len(recordings) < 2:
        return tuple(recordings)
    ordered = sorted(recordings, key=lambda recording: recording.clock_start + recording.time[0])
    for earlier, later in pairwise(ordered):
        pause = later.clock_start + later.time[0] - earlier.clock_start - earlier.time[-1]
        if not -0.5 / later.rate <= pause <= earlier.time[-1] - earlier.time[0]:
            return tuple(recordings)
    first = ordered[0].clock_start
    return tuple(replace(each, time=each.time + (each.clock_start - first), clock_start=first) for each in recordings)
