"""Torque commands and reference motions for the independent plant, as functions of (rng, time, scale)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def two_tone(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return the paper's excitation: 3 sin(12.07 t + r1) + 3 sin(2.25 t + r2) [N m]."""
    fast, slow = rng.uniform(0, 2 * np.pi, 2)
    return 3 * scale * (np.sin(12.07 * time + fast) + np.sin(2.25 * time + slow))


def other_tones(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return two tones of the paper's strength at other frequencies [N m]."""
    frequency = np.array([rng.uniform(6, 18), rng.uniform(0.8, 4)])  # rad/s
    phase = rng.uniform(0, 2 * np.pi, 2)
    return scale * np.sin(np.outer(time, frequency) + phase) @ rng.uniform(2, 4, 2)


def multisine(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return eight sines of 0.3 to 1.6 N m between 0.15 and 4 Hz, random phases [N m]: moderate motion."""
    frequency = 2 * np.pi * rng.uniform(0.15, 4, 8)  # rad/s
    phase = rng.uniform(0, 2 * np.pi, 8)
    return scale * np.sin(np.outer(time, frequency) + phase) @ rng.uniform(0.3, 1.6, 8)


def chirp(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return a sweep of 4.5 N m from about 0.1 to 4 Hz: slow full turns first, fast wagging last [N m]."""
    start, stop = rng.uniform(0.08, 0.2), rng.uniform(3, 5)  # Hz
    sweep = 2 * np.pi * (start * time + (stop - start) * time**2 / (2 * time[-1]))
    return scale * 4.5 * np.sin(sweep + rng.uniform(0, 2 * np.pi))


def prbs(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return a pseudo-random binary torque held for multiples of about 0.15 s [N m]."""
    clock = rng.uniform(0.12, 0.25)  # s
    level = rng.choice([-1.0, 1.0], int(time[-1] / clock) + 2)
    return scale * rng.uniform(2.5, 4) * level[(time / clock).astype(int)]


def steps(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return random levels held for random times [N m]."""
    edges = np.cumsum(rng.uniform(0.2, 1.2, int(time[-1] / 0.2) + 2))
    return scale * rng.uniform(-5, 5, len(edges) + 1)[np.searchsorted(edges, time)]


def filtered_noise(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return Gaussian noise through a second-order low-pass at 1 to 3 Hz, 2.5 N m RMS, limited to 7 N m [N m]."""
    pole = np.exp(-2 * np.pi * rng.uniform(1, 3) * (time[1] - time[0]))
    white, noise = rng.standard_normal(len(time)), np.empty(len(time))
    first = second = 0.0
    for k, w in enumerate(white.tolist()):
        first = pole * first + (1 - pole) * w
        second = pole * second + (1 - pole) * first
        noise[k] = second
    return np.clip(scale * 2.5 * noise / noise.std(), -7, 7)


def smooth_reference(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return a smooth random motion for a position loop to follow, about 1.5 rad RMS below 1.2 Hz [rad]."""
    frequency = rng.uniform(0.5, 7.5, 6)  # rad/s
    wave = np.sin(np.outer(time, frequency) + rng.uniform(0, 2 * np.pi, 6)) @ rng.uniform(0.4, 1.2, 6)
    return scale * wave * (1 - np.exp(-time / 0.5))  # starts at zero


def speed_profile(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return random constant speeds of 1 to 6 rad/s for 1 to 2 s each, integrated, for a speed loop [rad]."""
    edges = np.cumsum(rng.uniform(1.0, 2.0, int(time[-1]) + 2))
    speeds = rng.uniform(1.0, 6.0, len(edges) + 1) * rng.choice([-1.0, 1.0], len(edges) + 1)
    speed = speeds[np.searchsorted(edges, time)]
    pole, smooth, last = np.exp(-20.0 * (time[1] - time[0])), np.empty(len(time)), 0.0
    for k, wanted in enumerate(speed.tolist()):
        last = pole * last + (1 - pole) * wanted
        smooth[k] = last
    return scale * np.cumsum(smooth) * (time[1] - time[0])


def triangle(rng: np.random.Generator, time: Array, scale: float = 1.0) -> Array:
    """Return a slow triangle of two to four periods for a position loop [rad]."""
    phase = time / time[-1] * rng.uniform(2.0, 4.0)
    return scale * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * phase))


OPEN_LOOP: dict[str, Callable[[np.random.Generator, Array, float], Array]] = {
    "two_tone": two_tone,
    "other_tones": other_tones,
    "multisine": multisine,
    "chirp": chirp,
    "prbs": prbs,
    "steps": steps,
    "filtered_noise": filtered_noise,
}
CLOSED_LOOP: dict[str, Callable[[np.random.Generator, Array, float], Array]] = {
    "pd_loop": smooth_reference,
    "speed_loop": speed_profile,
    "triangle": triangle,
}
EXCITATIONS = (*OPEN_LOOP, "pd_loop", "speed_loop")  # of random cases
