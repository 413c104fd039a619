"""Where a model fails: regions of angle, velocity, torque, time and frequency whose residual stands out of noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lombscargle

from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Samples

AXES = {"position": "rad", "velocity": "rad/s", "torque": "N m", "time": "s"}
SYMBOLS = {"position": "q", "velocity": "q'", "torque": "tau", "time": "t", "frequency": "f"}
BINS = 24
STANDS_OUT = 5.0  # standard errors
COUNTABLE = 100.0  # standard errors, above which their number says nothing more to people


@dataclass(frozen=True)
class Profile:
    """Residual against one quantity: mean and scatter in bins of equal count.

    Attributes:
        axis: position, velocity, torque, time or frequency.
        unit: of the axis.
        edges: limits of the bins (K + 1,).
        mean: mean residual in each bin (K,) [N m]; for frequency the amplitude.
        error: its standard error from noise alone (K,) [N m].
    """

    axis: str
    unit: str
    edges: Array
    mean: Array
    error: Array


@dataclass(frozen=True)
class Region:
    """A stretch of one axis in which the residual stands out, in numbers and words."""

    axis: str
    low: float
    high: float
    residual: float  # mean [N m]
    significance: float  # in standard errors of the noise
    text: str

    def json(self) -> JSON:
        """Plain dictionary for JSON; null stands for no limit."""
        low, high = (limit if np.isfinite(limit) else None for limit in (self.low, self.high))
        return {
            "axis": self.axis,
            "low": low,
            "high": high,
            "residual": self.residual,
            "significance": self.significance,
            "text": self.text,
        }


def profile(axis: str, values: Array, residual: Array, noise: float) -> Profile:
    """Bin the residual (R,) over `values` (R,), bins of equal count; `noise` is its deviation from noise alone."""
    count = max(2, min(BINS, len(values) // 8))
    edges = np.quantile(values, np.linspace(0, 1, count + 1))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, count - 1)
    number = np.maximum(np.bincount(which, minlength=count), 1)
    mean = np.bincount(which, weights=residual, minlength=count) / number
    return Profile(axis, AXES[axis], edges, mean, noise / np.sqrt(number))


def spectrum(time: Array, residual: Array, noise: float) -> Profile:
    """Amplitude of the residual (R,) [N m] over frequency [Hz], by Lomb-Scargle, as windows in stick are missing.

    Source: Scargle, Astrophysical Journal 263, 1982.
    """
    span = float(np.ptp(time)) or 1.0
    step = float(np.median(np.diff(np.unique(time))))
    frequency = np.arange(1, max(2, min(400, int(0.4 * span / step)))) / span
    # one by one: all at once, SciPy holds several matrices of frequencies by windows
    power = np.array([np.squeeze(lombscargle(time, residual, [2 * np.pi * hertz])) for hertz in frequency])
    amplitude = np.sqrt(4 * power / len(residual))
    edges = np.r_[frequency - 0.5 / span, frequency[-1] + 0.5 / span]
    return Profile("frequency", "Hz", edges, amplitude, np.full(len(frequency), noise * np.sqrt(2 / len(residual))))


def profiles(x: Samples, residual: Array, noise: float) -> list[Profile]:
    """Profiles over position, velocity, torque and time, and the spectrum."""
    axes = [profile(axis, np.asarray(getattr(x, axis)), residual, noise) for axis in AXES]
    return [*axes, spectrum(np.asarray(x.time), residual, noise)]


def _in_words(axis: str, low: float, high: float, residual: float, significance: float) -> str:
    if axis == "frequency":
        place = f"around {0.5 * (low + high):.3g} Hz"
        return f"{place} the residual oscillates by {residual:.3g} N m ({_chance(significance)})"
    unit, symbol = AXES[axis], SYMBOLS[axis]
    side = "more" if residual > 0 else "less"
    return (
        f"for {symbol} from {low:.3g} to {high:.3g} {unit} the joint needs {abs(residual):.3g} N m {side} torque "
        f"than the model says ({_chance(significance)})"
    )


def _chance(significance: float) -> str:
    return f"{significance:.0f} standard errors" if significance <= COUNTABLE else "far beyond chance"


def stand_out(maps: Sequence[Profile], most: int = 6) -> list[Region]:
    """Regions whose mean residual exceeds five standard errors of the noise, the most telling first."""
    regions = []
    for item in maps:
        score = np.abs(item.mean) / np.maximum(item.error, 1e-12)
        signs = np.sign(item.mean) * (score > STANDS_OUT)
        if item.axis == "frequency":
            peak = int(np.argmax(score))
            signs = np.where(np.arange(len(score)) == peak, signs, 0)
        cuts = np.flatnonzero(np.diff(signs)) + 1
        for part in np.split(np.arange(len(signs)), cuts):
            if signs[part[0]] == 0:
                continue
            weight = 1 / np.maximum(item.error[part], 1e-12) ** 2
            mean = float(np.average(item.mean[part], weights=weight))
            sigma = abs(mean) * float(np.sqrt(weight.sum()))
            low, high = float(item.edges[part[0]]), float(item.edges[part[-1] + 1])
            regions.append(Region(item.axis, low, high, mean, sigma, _in_words(item.axis, low, high, mean, sigma)))
    return sorted(regions, key=lambda region: -region.significance)[:most]
