"""Position, velocity and acceleration from what was recorded, without delay, and how noisy they are."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.signal import savgol_filter

from pendulum_env._typing import Array
from pendulum_env.recording import Recording


def white_noise(series: Array) -> float:
    """Standard deviation of the white part of a smooth signal, from its fourth differences; robust against steps."""
    differences = np.diff(series, 4)
    spread = float(np.median(np.abs(differences))) / 0.6745 / np.sqrt(comb(8, 4))
    steps = np.abs(np.diff(series))
    quantum = float(steps[steps > 1e-12].min(initial=np.inf))
    return max(spread, quantum / np.sqrt(12)) if np.isfinite(quantum) else spread


def smooth_motion(position: Array, period: float, half_width: int) -> tuple[Array, Array]:
    """Zero-phase position and velocity from local cubic polynomials over 2 half_width + 1 samples."""
    length = min(2 * half_width + 1, len(position) - 1 + len(position) % 2)
    smoothed = savgol_filter(position, length, 3)
    velocity = savgol_filter(position, length, 3, deriv=1, delta=period)
    return smoothed, velocity


@dataclass(frozen=True)
class Motion:
    """Position, velocity and acceleration (N,), with the noise of the latter two after smoothing and windowing."""

    position: Array
    velocity: Array
    acceleration: Array
    velocity_noise: float
    acceleration_noise: float


def from_position(recording: Recording, window: Array, half_width: int) -> Motion:
    """Motion by differentiating the position; the acceleration will be averaged over `window`."""
    period = 1.0 / recording.rate
    q, v = smooth_motion(recording.position, period, half_width)
    a = np.zeros_like(q)
    a[1:-1] = np.diff(recording.position, 2) / period**2
    noise = white_noise(recording.position)
    # slope of the cubic fit: variance 28.1 / (2 s)^3 per unit of position noise, for large s
    slope = noise * np.sqrt(28.1 / (2 * half_width) ** 3) / period
    curvature = np.convolve(window, [1.0, -2.0, 1.0]) / period**2
    return Motion(q, v, a, slope, noise * float(np.linalg.norm(curvature)))


def from_velocity(recording: Recording, window: Array, half_width: int) -> Motion | None:
    """Motion from a measured velocity, None where that disagrees with the position."""
    if recording.velocity is None:
        return None
    period = 1.0 / recording.rate
    q, slope = smooth_motion(recording.position, period, half_width)
    v, a_smooth = smooth_motion(recording.velocity, period, half_width)
    # v = scale (q' - delay q''): a velocity in other units, or filtered, must not replace the encoder
    scale, lag = np.linalg.lstsq(np.column_stack([slope, -a_smooth]), v, rcond=None)[0]
    if abs(scale - 1) > 0.03 or abs(lag) > 0.5 * period:
        return None
    a = np.zeros_like(q)
    a[1:-1] = (recording.velocity[2:] - recording.velocity[:-2]) / (2 * period)
    noise = white_noise(recording.velocity)
    slope_of_window = np.convolve(window, [0.5, 0.0, -0.5]) / period
    return Motion(q, v, a, noise * 1.5 / np.sqrt(2 * half_width), noise * float(np.linalg.norm(slope_of_window)))
