"""Blocks of time of the equations of windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.weak_form.windows import Windows
from pendulum_env._typing import Index


def number_blocks(windows: Sequence[Windows], length: float) -> Index:
    """Return the block of about `length` seconds of each equation (R,), numbered from 0 over all recordings."""
    numbers, offset, first = [], 0, {}
    for w, run in zip(windows, list_recordings(windows), strict=True):
        count = max(1, round(w.recording.duration / length))
        which = np.minimum((w.centers * count) // len(w.recording), count - 1)
        if run not in first:
            first[run] = offset
            offset += count
        numbers.append(which + first[run])
    return np.unique(np.concatenate(numbers), return_inverse=True)[1]


def list_recordings(windows: Sequence[Windows]) -> list[int]:
    """Return the number of the recording of each entry: its `run`, or its index for a pendulum."""
    return [k if w.run is None else w.run for k, w in enumerate(windows)]
