"""Pieces of long recordings, by which a search compares models; the final fits have the whole recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pendulum_env.recording import Recording
from robots.servos.in_loop.settings import LOOP


def select_pieces(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """Select pieces of recordings of about `LOOP.search.count` samples in all, spread over each; all of short ones.

    A loop forgets its start, so each piece is a rollout of its own. Rollouts of equal length are simulated at once.
    """
    setting, total = LOOP.search, sum(map(len, recordings))
    if total <= setting.count:
        return recordings
    return tuple(_cut(recording, setting.count / total) for recording in recordings)


def _cut(recording: Recording, share: float) -> Recording:
    """Return about a share of the samples of a recording, in pieces as segments."""
    length = min(round(LOOP.search.piece * recording.rate), len(recording))
    count = max(1, round(share * len(recording) / length))
    begins = np.linspace(0, len(recording) - length, count + 2 if count > 1 else 3)[1:-1].astype(int)
    rows = np.unique(begins[:, None] + np.arange(length))
    starts = {*begins.tolist(), *recording.starts}
    is_start = np.isin(rows, [*starts]) | (np.diff(rows, prepend=rows[0] - 2) > 1)
    ends = np.append(is_start[1:], True)
    kept = ~(is_start & ends)  # a segment needs two samples
    rows, is_start = rows[kept], is_start[kept]
    series = {quantity: values[rows] for quantity, values in recording.series.items()}
    return replace(recording, **series, starts=tuple(np.flatnonzero(is_start).tolist()))
