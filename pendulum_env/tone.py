"""Detect motion of one frequency, in which position and acceleration are proportional."""

import numpy as np

from pendulum_env._typing import Array

ONE_FREQUENCY = 0.995  # least share of the power in one sine for "one frequency"; a triangle wave has 0.986
ZOOM, STEPS = 40, 3  # frequencies per refinement of the grid, and number of refinements
MAX_SAMPLES = 20_000  # samples after decimation of longer series; averages would remove fast motion
MIN_PEAK_SHARE = 0.9  # least share of the spectrum's power within two lines of its peak


def find_tone(series: Array, period: float) -> tuple[float, float]:
    """Find the sine with the largest share of the power of a series (N,).

    A linear trend is subtracted first. `period` is the sample time [s].

    Returns:
        Angular frequency [rad/s], and share of the power in this sine; both 0 if the spectrum has no dominant peak.
    """
    stride = max(1, len(series) // MAX_SAMPLES)
    series, period = series[::stride], stride * period
    time = np.arange(len(series)) * period
    line = np.column_stack([np.ones_like(time), np.linspace(-1.0, 1.0, len(time))])
    remainder = series - line @ np.linalg.lstsq(line, series, rcond=None)[0]
    power = float(remainder @ remainder)
    if power <= 0 or len(series) < 8:
        return 0.0, 0.0
    spacing = 2 * np.pi / (len(series) * period)
    spectrum, share = np.abs(np.fft.rfft(remainder)) ** 2, 0.0
    line_number = int(np.argmax(spectrum))
    if spectrum[max(line_number - 2, 0) : line_number + 3].sum() < MIN_PEAK_SHARE * spectrum.sum():
        return 0.0, 0.0
    frequency_estimate = spacing * max(1, line_number)
    for _ in range(STEPS):
        shares = []
        frequencies = frequency_estimate + spacing * np.linspace(-1.0, 1.0, ZOOM + 1)
        for frequency in frequencies:
            sine = np.column_stack([line, np.cos(frequency * time), np.sin(frequency * time)])
            remaining = series - sine @ np.linalg.lstsq(sine, series, rcond=None)[0]
            shares.append(1.0 - float(remaining @ remaining) / power)
        frequency_estimate, share, spacing = float(frequencies[np.argmax(shares)]), max(shares), 2 * spacing / ZOOM
    return frequency_estimate, share


def has_one_frequency(series: Array, period: float) -> bool:
    """Return whether a series (N,) has nearly all of its power in one sine."""
    return find_tone(series, period)[1] > ONE_FREQUENCY
