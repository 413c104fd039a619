"""Motion at one frequency, which cannot separate laws: position and acceleration are proportional."""

import numpy as np

from pendulum_env._typing import Array

ONE = 0.995  # share of the power of a motion in one sine, above which it has one frequency; of a triangle wave 0.986
ZOOM, STEPS = 40, 3  # frequencies tried about the best one, and repetitions with a smaller spacing
ENOUGH = 20_000  # samples that are kept of longer series; an average would remove fast motion
LEAST = 0.9  # share of the power within two lines of the best one of a spectrum, below which there is no tone


def find_tone(series: Array, period: float) -> tuple[float, float]:
    """Return the angular frequency [rad/s] and the share of the power of a series (N,) in one sine.

    A line over time, and the mean, count as no power. The share is 0 far from one sine.
    `period` is the sample time [s].
    """
    stride = max(1, len(series) // ENOUGH)
    series, period = series[::stride], stride * period
    time = np.arange(len(series)) * period
    line = np.column_stack([np.ones_like(time), np.linspace(-1.0, 1.0, len(time))])
    rest = series - line @ np.linalg.lstsq(line, series, rcond=None)[0]
    power = float(rest @ rest)
    if power <= 0 or len(series) < 8:
        return 0.0, 0.0
    spacing = 2 * np.pi / (len(series) * period)
    spectrum, share = np.abs(np.fft.rfft(rest)) ** 2, 0.0
    line_number = int(np.argmax(spectrum))
    if spectrum[max(line_number - 2, 0) : line_number + 3].sum() < LEAST * spectrum.sum():
        return 0.0, 0.0
    best = spacing * max(1, line_number)
    for _ in range(STEPS):
        shares = []
        frequencies = best + spacing * np.linspace(-1.0, 1.0, ZOOM + 1)
        for frequency in frequencies:
            sine = np.column_stack([line, np.cos(frequency * time), np.sin(frequency * time)])
            remaining = series - sine @ np.linalg.lstsq(sine, series, rcond=None)[0]
            shares.append(1.0 - float(remaining @ remaining) / power)
        best, share, spacing = float(frequencies[np.argmax(shares)]), max(shares), 2 * spacing / ZOOM
    return best, share


def has_one_frequency(series: Array, period: float) -> bool:
    """Return whether a series (N,) has nearly all of its power in one sine."""
    return find_tone(series, period)[1] > ONE
