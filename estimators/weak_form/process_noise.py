"""Torque noise that moves a joint and is not logged: the white part of a residual beyond the noise of the sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from estimators.weak_form.torque_windows import WEAK_FORM, TorqueWindows
from estimators.weak_form.windows import Windows
from pendulum_env._typing import Array, Index

P_VALUE = 0.05  # of all tests of all recordings together, above which a residual counts as white noise
LONGEST = 1.0  # longest lag of the tests [s]


def add_process_noise(data: TorqueWindows, residual: Array, inertia: float) -> TorqueWindows | None:
    """Return the windows of a pendulum with torque noise that explains a residual, or None if it is not white noise.

    Noise of the torque that is not logged is white: in windows that do not overlap it has no correlation, the same
    variance at all times, and a normal distribution. Windows half a window apart share a known part of it. A missing
    effect violates one of these properties, so the p-value of each is above `P_VALUE` over the number of tests. A
    recording needs `WEAK_FORM.enough` windows for this.

    Args:
        data: windows of recordings.
        residual: residual of a model (R,) [N m].
        inertia: inertia of the joint [kg m^2], which gives the noise of the sensors.
    """
    of_recordings = np.split(residual, np.cumsum([len(w.centers) for w in data.windows])[:-1])
    p_values = list[float]()
    for w, noise in zip(data.windows, of_recordings, strict=True):
        half = len(w.kernel) // 2
        place, remainder = np.divmod(w.centers - w.first, 2 * half)
        is_separate = remainder < half
        if np.sum(is_separate) < WEAK_FORM.enough:
            return None
        last = round(0.5 * LONGEST * w.recording.rate / half)
        p_values += compute_white_p_values(noise[is_separate], place[is_separate], last)
    pairs = zip(data.windows, of_recordings, strict=True)
    noisier = replace(data, windows=tuple(_raise_noise(w, noise, inertia) for w, noise in pairs))
    p_values.append(float(chdtrc(1, noisier.measure_structure(residual, inertia).z_score ** 2)))
    return noisier if len(p_values) * min(p_values) > P_VALUE else None


def compute_white_p_values(noise: Array, place: Index, last: int) -> tuple[float, float, float]:
    """Return the p-values of three properties of white noise (R,): no correlation, one variance, a normal distribution.

    A changing variance correlates absolute values. `place` (R,) is the place of each value in
    time, `last` is the longest lag.
    """
    series, size = np.zeros((2, int(place[-1]) + 1)), np.abs(noise)
    series[:, place] = noise, size - size.mean()
    products = [series[:, :-lag] * series[:, lag:] for lag in range(1, min(last, series.shape[1] // 4) + 1)]
    squares = [np.sum(each, axis=1) ** 2 / np.maximum(np.sum(each**2, axis=1), 1e-300) for each in products]
    of_correlation, of_variance = chdtrc(len(squares), np.sum(squares, axis=0)).tolist()
    kurtosis = float(np.mean(noise**4) / np.mean(noise**2) ** 2) - 3.0
    return of_correlation, of_variance, float(chdtrc(1, len(noise) * kurtosis**2 / 24.0))


def _raise_noise(w: Windows, residual: Array, inertia: float) -> Windows:
    """Return windows with torque noise raised so that all noise has at least the power of a residual (R,) [N m]."""
    excess = max(float(np.mean(residual**2)) - w.noise(inertia) ** 2, 0.0)
    return replace(w, torque_noise=float(np.hypot(w.torque_noise, np.sqrt(excess))))
