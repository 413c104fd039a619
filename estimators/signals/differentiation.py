"""Position, velocity and acceleration of a recording without delay, and their noise."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pendulum_env._typing import Array, Mask
from pendulum_env.filters import filter_savitzky_golay
from pendulum_env.recording import Recording
from pendulum_env.recording.rounding import find_least_change, list_changes

FOURTH = {1: np.array([1.0, -4, 6, -4, 1]), 2: np.array([1.0, 0, -4, 0, 6, 0, -4, 0, 1])}  # differences, by step
LARGER = float(np.log(1.25))  # largest excess of coarse differences over those of noise, in the logarithm
REMOVED = 2.5  # largest difference of raw and smoothed position [standard deviations of noise]
STILL = 1e-9  # [rad], largest change of position from sample to sample at rest


def estimate_scatter(series: Array, where: Mask | slice = np.s_[:]) -> float:
    """Estimate the standard deviation of white noise on a signal (N,) that is mostly smooth or constant.

    The estimate is the smaller of the scaled median and the RMS of the fourth differences in `where` (N - 4,). Rare
    jumps do not change the median. For a slow rounded signal the median is up to 2.5 times too large, the RMS at most
    1.7 times.
    """
    differences = np.abs(np.diff(series, 4))[where]
    return float(min(np.median(differences) / 0.6745, np.sqrt(np.mean(differences**2))) / np.sqrt(comb(8, 4)))


def estimate_white_noise(series: Array) -> float:
    """Estimate the standard deviation of white noise on a smooth signal (N,), at least that of its rounding."""
    return max(estimate_scatter(series), find_rounding(series) / np.sqrt(12))


def find_rounding(series: Array) -> float:
    """Find the step of rounding of a signal (N,), its smallest change above 1e-12; 0 without rounding.

    A held command counts as not rounded. It rests for more than three quarters of the samples and changes by more than
    one step, or has at most three values.
    """
    changes, step = list_changes(series), find_least_change(series)
    if not step:
        return 0.0
    values = np.unique(np.rint((series - series[0]) / step))
    is_held = 4 * len(changes) < len(series) and np.quantile(changes, 0.95) > 1.5 * step
    return 0.0 if is_held or len(values) <= 3 else step


def estimate_log_noise(series: Array, position: Array) -> float:
    """Estimate the standard deviation of white noise on a logged signal (N,), at least that of samples in motion.

    A signal may have no noise at rest. `position` (N,) shows the motion [rad].
    """
    moved = np.abs(np.diff(position)) > STILL
    in_motion = np.asarray(sliding_window_view(moved, 4).any(axis=1))  # for each fourth difference
    noise = estimate_white_noise(series)
    return max(noise, estimate_scatter(series, in_motion)) if in_motion.any() else noise


def estimate_encoder_noise(recording: Recording) -> float:
    """Estimate the standard deviation of encoder noise [rad] of a recording, at least that of its step in the file.

    Interpolation hides this step.
    """
    return max(estimate_position_noise(recording.position), recording.position_step / np.sqrt(12))


def estimate_position_noise(position: Array) -> float:
    """Estimate the standard deviation of encoder noise [rad] on a position (N,), at least that of samples in motion.

    A position is no command: it may rest for most of the time and move by several steps, and is rounded nevertheless.
    """
    return max(estimate_log_noise(position, position), find_least_change(position) / np.sqrt(12))


def estimate_noise_slope(position: Array, torque: Array) -> float:
    """Estimate the slope of the torque's noise over the position's noise [N m/rad], from fourth differences (N - 4,).

    Differences of torque beyond four standard deviations are jumps and are left out.
    """
    of_position, of_torque = np.diff(position, 4), np.diff(torque, 4)
    is_calm = np.abs(of_torque) <= 4 / 0.6745 * np.median(np.abs(of_torque))
    return float(of_torque[is_calm] @ of_position[is_calm] / max(np.sum(of_position[is_calm] ** 2), 1e-300))


def has_white_noise(series: Array, response: Array) -> bool:
    """Return whether the noise of a filtered signal (N,) is white, instead of white before the filter.

    Fourth differences of every sample and of every second one have the same scatter under white noise, in ratio. White
    noise before a filter with an impulse response (L,) has another ratio; the nearer of both decides. If the signal
    itself changes faster, coarse differences exceed those of either noise. Jumps in most stretches of nine samples hide
    the noise.
    """
    scatters = estimate_scatter(series), estimate_scatter(series[::2])
    fine, coarse = np.log(np.maximum(scatters, 1e-300))
    of_fine, of_coarse = (float(np.linalg.norm(np.convolve(response, FOURTH[step]))) for step in (1, 2))
    ratio, filtered_ratio = coarse - fine, float(np.log(of_coarse / of_fine))
    is_noise = ratio <= max(filtered_ratio, 0.0) + LARGER
    return bool(is_noise and abs(ratio) < abs(ratio - filtered_ratio))


def find_near_reversals(velocity: Array, moving: Mask, distance: int) -> Mask:
    """Find samples within `distance` samples of stick, where `moving` (N,) is false, or of a reversal (N,)."""
    return find_near(find_halts(velocity, moving), distance)


def find_halts(velocity: Array, moving: Mask) -> Mask:
    """Find samples in stick, where `moving` (N,) is false, and those after a reversal (N,)."""
    is_halted = ~moving
    is_halted[1:] |= np.sign(velocity[1:]) != np.sign(velocity[:-1])
    return np.asarray(is_halted)


def find_near(marked: Mask, distance: int) -> Mask:
    """Find samples within `distance` samples of marked ones (N,)."""
    marked_before, index = np.cumsum(np.append(0, marked)), np.arange(len(marked))
    first, stop = np.maximum(index - distance, 0), np.minimum(index + distance + 1, len(marked))
    return np.asarray(marked_before[stop] > marked_before[first])


def correlate_averages(weights: Array, lag: int) -> float:
    """Compute the correlation of averages of white noise with weights (K,), `lag` samples apart."""
    return float(weights[lag:] @ weights[: len(weights) - lag]) / float(weights @ weights)


def smooth_position(recording: Recording, half_width: int, derivative: int = 0) -> Array:
    """Smooth the position (N,), or its time derivative, by local cubics over 2 half_width + 1 samples.

    The filter has no delay. Each segment of the recording is smoothed alone, with a shorter filter if it is short.
    """
    parts, period = [], 1.0 / recording.rate
    for rows in recording.segment_slices:
        segment = recording.position[rows]
        length = min(2 * half_width + 1, len(segment) - 1 + len(segment) % 2)
        parts.append(filter_savitzky_golay(segment, length, min(3, length - 1), derivative, period))
    return np.concatenate(parts)


def smooth_to_noise(recording: Recording, longest: int, noise: float) -> tuple[Array, int]:
    """Smooth the position by the longest filter that removes noise alone; return it (N,) and the half width [samples].

    The position differs from the smoothed one by at most `REMOVED` standard deviations, `noise` [rad], by the median
    over samples in motion: shorter parts may differ by more. The half width is from 2 to `longest` samples.

    Source: Morozov, Soviet Mathematics Doklady 7, 1966 (the discrepancy principle).
    """
    position, half_width = recording.position, longest
    moved = np.append(np.abs(np.diff(position)) > STILL, False)
    while True:
        smoothed = smooth_position(recording, half_width)
        removed = np.abs(position - smoothed)[find_near(moved, half_width)]
        if half_width <= 2 or not len(removed) or np.median(removed) <= REMOVED * 0.6745 * noise:
            return smoothed, half_width
        half_width = max(2, 3 * half_width // 4)


@dataclass(frozen=True)
class Motion:
    """Motion of N samples, with its noise.

    Attributes:
        position, velocity: smoothed (N,) [rad], [rad/s].
        acceleration: second differences of the raw position (N,) [rad/s^2]; zero at the first and last sample.
        velocity_noise: standard deviation of the velocity [rad/s].
        acceleration_noise: standard deviation of the acceleration's average over a window [rad/s^2].
        noise_weights: weights (K,) of the positions in this average, of zero mean [1/s^2], or of the velocities of
            which they are the integral [1/s].
        half_width: half width of the smoothing [samples].
    """

    position: Array
    velocity: Array
    acceleration: Array
    velocity_noise: float
    acceleration_noise: float
    noise_weights: Array
    half_width: int


def differentiate_position(recording: Recording, window: Array, longest: int) -> Motion:
    """Compute the motion from the position alone; the delay of a logged velocity would bias inertia.

    The noise of an integrated position is that of its velocity. Smoothing has at most `longest` samples, see
    `smooth_to_noise`. `window` (K - 2,) are the weights of windows that average the acceleration.
    """
    period, encoder_noise = 1.0 / recording.rate, estimate_encoder_noise(recording)
    q, half_width = smooth_to_noise(recording, longest, encoder_noise)
    v = smooth_position(recording, half_width, derivative=1)
    a = np.zeros_like(q)
    a[1:-1] = np.diff(recording.position, 2) / period**2
    # variance of the slope of a cubic fit to 2 s samples: 28.1 / (2 s)^3 per unit of noise, 2.5 / (2 s) of its integral
    if recording.velocity is not None and recording.has_integrated_position:
        noise = estimate_log_noise(recording.velocity, recording.position)
        velocity_noise = noise * np.sqrt(2.5 / (2 * half_width))
        weights = np.convolve(window, [0.5, 0.0, -0.5]) / period
    else:
        noise = encoder_noise
        velocity_noise = noise * np.sqrt(28.1 / (2 * half_width) ** 3) / period
        weights = np.convolve(window, [1.0, -2.0, 1.0]) / period**2
    acceleration_noise = noise * float(np.linalg.norm(weights))
    return Motion(q, v, a, velocity_noise, acceleration_noise, weights, half_width)
