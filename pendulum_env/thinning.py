"""Fewer points of a curve than were measured, for a picture that shows the same."""

import numpy as np

from pendulum_env._typing import Array, Index

POINTS = 2400  # of one curve, at most; more than a screen is wide


def thin(series: Array, most: int = POINTS) -> Index:
    """Return indices of about `most` samples of a series (N,) that keep every peak: extremes of equal parts."""
    if len(series) <= most:
        return np.arange(len(series))
    parts = np.array_split(np.arange(len(series)), most // 2)
    ends = [(part[np.argmin(series[part])], part[np.argmax(series[part])]) for part in parts]
    return np.unique(np.array(ends))
