"""Torque noise that moves a joint and is not logged: the white part of a residual beyond the noise of the sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, ndtri

from estimators.decisions.criterion import WhiteNoiseLimits
from estimators.findings import Finding, Quantity
from estimators.weak_form.torque_windows import TorqueWindows
from estimators.weak_form.windows import Windows, mark_contacts
from pendulum_env._typing import Array, Index
from pendulum_env.units import JointUnits


@dataclass(frozen=True)
class UnloggedTorque(Finding):
    """White torque noise that is not logged.

    Attributes:
        torque: noise of a sample.
        hidden: largest RMS of an effect that it hides.
    """

    torque: Quantity
    hidden: Quantity


class ProcessNoise(NamedTuple):
    """White torque noise that is not logged.

    Attributes:
        data: windows with this noise.
        std: standard deviation of the noise of a sample [N m], the largest of all recordings.
        hidden: upper bound of the RMS of an effect that the noise hides [N m], if it lasts for two windows or longer.
    """

    data: TorqueWindows
    std: float
    hidden: float

    def make_finding(self, units: JointUnits) -> UnloggedTorque:
        """Return the finding on the noise and on the effects that it hides."""
        return UnloggedTorque(*(Quantity(size, unit=units.unit("N m")) for size in (self.std, self.hidden)))


def find_process_noise(
    data: TorqueWindows, residual: Array, inertia: float, limits: WhiteNoiseLimits
) -> ProcessNoise | None:
    """Return the torque noise that explains a residual of a pendulum, or None if the residual is not white noise.

    Noise of the torque that is not logged is white: in windows that do not overlap it has no correlation, the same
    variance throughout a recording, and a normal distribution. Windows half a window apart share a known part of it. A
    missing effect violates one of these four properties. Each is tested on all recordings together, so that more data
    show smaller effects. Windows in contact with a stop do not count. Few windows could hide a large part of the
    residual, and show nothing.

    Args:
        data: windows of recordings.
        residual: residual of a model (R,) [N m].
        inertia: inertia of the joint [kg m^2], which gives the noise of the sensors.
        limits: limits of white noise.
    """
    is_clear = [~mark_contacts(w) for w in data.windows]
    ends = np.cumsum([len(w.centers) for w in data.windows])[:-1]
    of_recordings = [part[rows] for part, rows in zip(np.split(residual, ends), is_clear, strict=True)]
    clear = [replace(w, centers=w.centers[rows]) for w, rows in zip(data.windows, is_clear, strict=True)]
    last = max(max(1, round(limits.longest_lag * w.recording.rate / (len(w.kernel) - 1))) for w in clear)
    torques, relative, places, start = list[Array](), list[Array](), list[Index](), 0
    for w, torque in zip(clear, of_recordings, strict=True):
        half = len(w.kernel) // 2
        place, remainder = np.divmod(w.centers - w.first, 2 * half)
        is_separate = remainder < half
        if is_separate.any():
            torques.append(torque[is_separate])
            relative.append(torques[-1] / max(float(np.sqrt(np.mean(torques[-1] ** 2))), 1e-300))
            places.append(place[is_separate] + start)
            start = int(places[-1][-1]) + last + 1  # no lag connects two recordings
    if not torques:
        return None
    place, separate = np.concatenate(places), np.concatenate(torques)
    hidden = bound_hidden_effect(separate, place, limits.p_value)
    if hidden**2 >= limits.most_hidden * np.mean(separate**2):
        return None
    noisier = [_raise_noise(w, torque, inertia) for w, torque in zip(clear, of_recordings, strict=True)]
    excesses = [_compare_neighbours(w, torque, inertia) for w, torque in zip(noisier, of_recordings, strict=True)]
    excess = np.concatenate(excesses)
    of_neighbours = float(chdtrc(1, np.sum(excess) ** 2 / max(float(np.sum(excess**2)), 1e-300)))
    p_values = compute_white_p_values(np.concatenate(relative), place, last)
    if 4 * min(*p_values, of_neighbours) <= limits.p_value:
        return None
    raised = tuple(
        replace(w, noise=w.noise.with_torque(n.noise.torque)) for w, n in zip(data.windows, noisier, strict=True)
    )
    variances = [n.noise.raw_torque**2 - w.noise.raw_torque**2 for w, n in zip(clear, noisier, strict=True)]
    return ProcessNoise(replace(data, windows=raised), float(np.sqrt(max(variances))), hidden)


def compute_white_p_values(noise: Array, place: Index, last: int) -> tuple[float, float, float]:
    """Return the p-values of three properties of white noise (R,): no correlation, one variance, a normal distribution.

    A changing variance correlates absolute values. `place` (R,) is the place of each value in
    time, `last` is the longest lag, one at least. Zeros have p-values of one.
    """
    if not noise.any():
        return 1.0, 1.0, 1.0
    series, size = np.zeros((2, int(place[-1]) + 1)), np.abs(noise)
    series[:, place] = noise, size - size.mean()
    lags = range(1, max(1, min(last, series.shape[1] // 4)) + 1)
    products = [series[:, :-lag] * series[:, lag:] for lag in lags]
    squares = [np.sum(each, axis=1) ** 2 / np.maximum(np.sum(each**2, axis=1), 1e-300) for each in products]
    of_correlation, of_variance = chdtrc(len(squares), np.sum(squares, axis=0)).tolist()
    kurtosis = float(np.mean(noise**4) / np.mean(noise**2) ** 2) - 3.0
    return of_correlation, of_variance, float(chdtrc(1, len(noise) * kurtosis**2 / 24.0))


def bound_hidden_effect(noise: Array, place: Index, p_value: float) -> float:
    """Return the upper bound of the RMS of an effect in noise (R,), by the mean product of neighbours in time.

    `place` (R,) is the place of each value; the RMS is above the bound with a probability `p_value`. Without neighbours
    the bound is the RMS of the noise.
    """
    is_pair = np.diff(place) == 1
    product = (noise[:-1] * noise[1:])[is_pair]
    if not len(product):
        return float(np.sqrt(np.mean(noise**2)))
    error = float(np.sqrt(np.sum(product**2))) / len(product)
    return float(np.sqrt(max(float(product.mean()), 0.0) + float(ndtri(1.0 - p_value)) * error))


def _compare_neighbours(w: Windows, residual: Array, inertia: float) -> Array:
    """Return the products of residuals (R,) half a window apart minus their mean by noise, relative to its power (S,).

    The mean is the correlation by noise times the power of each pair, so that an error of the power does not matter.
    """
    neighbours = np.flatnonzero(np.diff(w.centers) == len(w.kernel) // 2)
    first, second = residual[neighbours], residual[neighbours + 1]
    variance = max(w.noise.compute_std(inertia) ** 2, 1e-300)
    expected = 0.5 * (first**2 + second**2) * w.noise.compute_shared_covariance(inertia) / variance
    return np.asarray((first * second - expected) / variance)


def _raise_noise(w: Windows, residual: Array, inertia: float) -> Windows:
    """Return windows with torque noise raised so that all noise has at least the power of a residual (R,) [N m]."""
    excess = max(float(np.sum(residual**2)) / max(len(residual), 1) - w.noise.compute_std(inertia) ** 2, 0.0)
    return replace(w, noise=w.noise.with_torque(float(np.hypot(w.noise.torque, np.sqrt(excess)))))
