"""Position, velocity and acceleration of a recording without delay, and their noise."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pendulum_env._typing import Array, Mask
from pendulum_env.filters import filter_savitzky_golay
from pendulum_env.recording import Recording

STILL = 1e-9  # [rad] or any unit, change of a signal from sample to sample that is rounding alone


def estimate_scatter(series: Array, where: Mask | slice = np.s_[:]) -> float:
    """Estimate the standard deviation of white noise on a signal that is mostly smooth or constant.

    The estimate is the smaller of two: the median of fourth differences, which rare jumps of the signal do not change,
    and their root mean square. Of a slow signal that an encoder rounds, differences are one or three steps: the median
    is up to 2.5 times too large, the root mean square at most 1.7 times. `find_rounding` gives a lower bound.
    `where` selects among the differences (N - 4,).
    """
    differences = np.abs(np.diff(series, 4))[where]
    return float(min(np.median(differences) / 0.6745, np.sqrt(np.mean(differences**2))) / np.sqrt(comb(8, 4)))


def estimate_white_noise(series: Array) -> float:
    """Estimate the standard deviation of the white part of a smooth signal, including rounding."""
    return max(estimate_scatter(series), find_rounding(series) / np.sqrt(12))


def find_rounding(series: Array) -> float:
    """Find the step to whose multiples a signal was rounded; 0 without rounding.

    A command that is held has a least change, too, and was not rounded to that: at rest for three quarters of the time,
    it changes by more than that at once, or only switches between two or three values.
    """
    changes = np.abs(np.diff(series))
    changes = changes[changes > 1e-12]
    if not len(changes):
        return 0.0
    step = float(changes.min())
    values = np.unique(np.rint((series - series[0]) / step))
    is_held = 4 * len(changes) < len(series) and np.quantile(changes, 0.95) > 1.5 * step
    return 0.0 if is_held or len(values) <= 3 else step


def estimate_encoder_noise(position: Array) -> float:
    """Estimate the standard deviation of encoder noise [rad]; samples at rest are left out."""
    moved = np.abs(np.diff(position)) > STILL
    near = np.asarray(sliding_window_view(moved, 4).any(axis=1))  # of each difference of four steps
    return (
        max(estimate_white_noise(position), estimate_scatter(position, near))
        if near.any()
        else estimate_white_noise(position)
    )


def find_near_reversals(velocity: Array, moving: Mask, distance: int) -> Mask:
    """Find samples near stick, where the velocity has no sign, or near a reversal (N,)."""
    halted = ~moving
    halted[1:] |= np.sign(velocity[1:]) != np.sign(velocity[:-1])
    so_far, place = np.cumsum(np.append(0, halted)), np.arange(len(halted))
    first, stop = np.maximum(place - distance, 0), np.minimum(place + distance + 1, len(halted))
    return np.asarray(so_far[stop] > so_far[first])


def correlate_averages(weights: Array, lag: int) -> float:
    """Compute the correlation of two averages of white noise with equal weights (K,) at a lag."""
    return float(weights[lag:] @ weights[: len(weights) - lag]) / float(weights @ weights)


def smooth_motion(recording: Recording, series: Array, half_width: int) -> tuple[Array, Array]:
    """Smooth a series (N,) by local cubics over 2 half_width + 1 samples, and return values and slope without delay.

    Each segment is smoothed on its own: nothing is known of what happens in a gap.
    """
    parts = []
    for first, stop in pairwise((*recording.starts, len(recording))):
        part = series[first:stop]
        length = min(2 * half_width + 1, len(part) - 1 + len(part) % 2)
        order = min(3, length - 1)
        slope = filter_savitzky_golay(part, length, order, 1, 1.0 / recording.rate)
        parts.append((filter_savitzky_golay(part, length, order), slope))
    smoothed, slopes = zip(*parts, strict=True)
    return np.concatenate(smoothed), np.concatenate(slopes)


@dataclass(frozen=True)
class Motion:
    """Position, velocity and acceleration (N,), with the noise of the latter two after smoothing and windowing.

    What of the acceleration's is noise comes from white noise of an encoder under weights (K,) of zero mean, so that
    windows beside each other share it with the opposite sign.
    """

    position: Array
    velocity: Array
    acceleration: Array
    velocity_noise: float
    acceleration_noise: float
    noise_weights: Array


def differentiate_position(recording: Recording, window: Array, half_width: int) -> Motion:
    """Compute the motion by differentiation of the position; the acceleration will be averaged over `window`.

    The velocity of a log is not used: most are computed from the same encoder, and a difference over two samples of
    10 ms biases the inertia by up to one percent.
    """
    period = 1.0 / recording.rate
    q, v = smooth_motion(recording, recording.position, half_width)
    a = np.zeros_like(q)
    a[1:-1] = np.diff(recording.position, 2) / period**2
    noise = estimate_encoder_noise(recording.position)
    # slope of the cubic fit: variance 28.1 / (2 s)^3 per unit of position noise, for large s
    slope = noise * np.sqrt(28.1 / (2 * half_width) ** 3) / period
    curvature = np.convolve(window, [1.0, -2.0, 1.0]) / period**2
    return Motion(q, v, a, slope, noise * float(np.linalg.norm(curvature)), curvature)
