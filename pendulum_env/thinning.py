"""Reduce the points of a curve for a plot."""

import numpy as np

from pendulum_env._typing import Array, Index

POINTS = 2400  # most points of a curve, more than the width of a screen


def thin(series: Array, most: int = POINTS) -> Index:
    """Return indices of about `most` samples of a series (N,): the minimum and maximum of equal parts."""
    if len(series) <= most:
        return np.arange(len(series))
    parts = np.array_split(np.arange(len(series)), most // 2)
    ends = [(part[np.argmin(series[part])], part[np.argmax(series[part])]) for part in parts]
    return np.unique(np.array(ends))
