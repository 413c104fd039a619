"""Regions of angle, velocity, torque, time and frequency with a significant residual."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.findings import Finding
from pendulum_env._typing import JSON, Array
from pendulum_env.physics import Samples
from pendulum_env.units import TURNING, JointUnits

AXES = {"position": "rad", "velocity": "rad/s", "torque": "N m", "time": "s"}
SYMBOLS = {"position": "q", "velocity": "q'", "torque": "tau", "time": "t", "frequency": "f"}


@dataclass(frozen=True)
class RegionSettings:
    """Settings of profiles, and limits of significant regions."""

    bins: int = 24
    turns: float = 2.0  # turns of the joint, from which on its angle is told within one
    fine: int = 4  # times as many bins over a turn: what repeats along it repeats often
    share: float = 0.03  # of what the first finding tells, that another has to
    stands_out: float = 5.0  # standard errors


REGIONS = RegionSettings()
WITHIN = "rad within a turn"


@dataclass(frozen=True)
class Profile:
    """Residual over one quantity: mean and scatter in bins of equal count.

    Attributes:
        axis: position, velocity, torque, time or frequency.
        unit: of the axis.
        units: at the joint, of axis and residual.
        edges: limits of the bins (K + 1,).
        mean: mean residual in each bin (K,) [N m]; for frequency the amplitude.
        error: its standard error from noise alone (K,) [N m].
    """

    axis: str
    unit: str
    edges: Array
    mean: Array
    error: Array
    units: JointUnits = TURNING


@dataclass(frozen=True)
class Region:
    """Interval of one axis with a significant residual.

    Attributes:
        axis: position, velocity, torque, time or frequency.
        low, high: ends of the stretch.
        residual: mean [N m]; for frequency the amplitude.
        significance: in standard errors of the noise.
        unit: of the axis.
        at: joint of an arm.
        units: at the joint, of axis and residual.
        is_profiled: whether the stretch is one of a profile; else nothing stands out at one place.
        held_out: names of recordings, if the residual is that of held-out data alone.
        cause: a finding that says more than the stretch.
    """

    axis: str
    low: float
    high: float
    residual: float
    significance: float
    unit: str = ""
    at: str = ""
    units: JointUnits = TURNING
    is_profiled: bool = True
    held_out: tuple[str, ...] = ()
    cause: Finding | None = None

    @property
    def is_constant(self) -> bool:
        """Return whether the residual is constant."""
        return self.axis == "time" and not self.unit

    @property
    def kind(self) -> str:
        """Return the kind of the cause, or the axis."""
        return str(self.cause.kind) if self.cause is not None else self.axis

    def json(self) -> JSON:
        """Return a dictionary for JSON; null means no limit."""
        low, high = (limit if np.isfinite(limit) else None for limit in (self.low, self.high))
        return {
            "joint": self.at,
            "axis": self.axis,
            "low": low,
            "high": high,
            "unit": self.unit,
            "residual": self.residual,
            "significance": self.significance,
            "held_out": [*self.held_out],
            "cause": self.cause.json() if self.cause is not None else None,
        }


def make_region_everywhere(
    cause: Finding | None = None,
    x: Samples | None = None,
    size: float = 0.0,
    floor: float = 1.0,
    at: str = "",
    units: JointUnits = TURNING,
) -> Region:
    """Return the region of all recorded speeds, or of any: the residual is at no one place."""
    fast = np.inf if x is None else float(np.abs(x.velocity).max())
    return Region(
        "velocity", -fast, fast, size, size / floor, units.unit("rad/s"), at, units, is_profiled=False, cause=cause
    )


def makes_whole_turns(position: Array) -> bool:
    """Return whether a joint makes whole turns, so that its angle (R,) [rad] is taken within a turn."""
    return bool(np.ptp(position) > REGIONS.turns * 2 * np.pi)


def wrap_angles(position: Array) -> Array:
    """Wrap angles (N,) to one turn [rad]."""
    return (np.asarray(position) + np.pi) % (2 * np.pi) - np.pi


def profile(axis: str, values: Array, residual: Array, noise: float) -> Profile:
    """Bin the residual (R,) over `values` (R,) with equal counts; `noise` is the standard deviation of noise alone.

    The angle of a joint that turns is taken within a turn.
    """
    around = axis == "position" and makes_whole_turns(values)
    values, unit = (wrap_angles(values), WITHIN) if around else (np.asarray(values), AXES[axis])
    count = max(2, min(REGIONS.bins * (REGIONS.fine if around else 1), len(values) // 8))
    edges = np.quantile(values, np.linspace(0, 1, count + 1))
    which = _make_bins(values, edges)
    number = np.maximum(np.bincount(which, minlength=count), 1)
    mean = np.bincount(which, weights=residual, minlength=count) / number
    return Profile(axis, unit, edges, mean, noise / np.sqrt(number))


def _make_bins(values: Array, edges: Array) -> Array:
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def compute_spectrum(time: Array, residual: Array, noise: float) -> Profile:
    """Compute the amplitude of the residual (R,) [N m] over frequency [Hz] by Lomb-Scargle, as windows may be missing.

    Source: Scargle, Astrophysical Journal 263, 1982.
    """
    span = float(np.ptp(time)) or 1.0
    step = float(np.median(np.diff(np.unique(time))))
    frequency = np.arange(1, max(2, min(400, int(0.4 * span / step)))) / span
    amplitude = np.array([_fit_amplitude(time, residual, 2 * np.pi * hertz) for hertz in frequency])
    edges = np.r_[frequency - 0.5 / span, frequency[-1] + 0.5 / span]
    return Profile("frequency", "Hz", edges, amplitude, np.full(len(frequency), noise * np.sqrt(2 / len(residual))))


def _fit_amplitude(time: Array, residual: Array, omega: float) -> float:
    """Fit a cosine and a sine of omega [rad/s], and return the amplitude of their sum.

    It is sqrt(4 P / R) of the power P by `scipy.signal.lombscargle`, whose package takes half a second to import.
    """
    wave = np.exp(1j * omega * time)
    overlap = np.mean(wave**2)  # 0 if cosine and sine are orthogonal; else turning the phase makes them so
    share = np.mean(residual * wave) * np.exp(-0.5j * np.angle(overlap))
    size = abs(overlap)
    return float(2 * np.sqrt(share.real**2 / (1 + size) + share.imag**2 / max(1 - size, np.finfo(float).eps)))


def compute_profiles(
    x: Samples, residual: Array, noise: float, axes: Sequence[str] = tuple(SYMBOLS), units: JointUnits = TURNING
) -> list[Profile]:
    """Compute profiles over position, velocity, torque and time, and the spectrum, or some of these."""
    found = [
        compute_spectrum(np.asarray(x.time), residual, noise)
        if axis == "frequency"
        else profile(axis, np.asarray(getattr(x, axis)), residual, noise)
        for axis in axes
        if axis != "torque" or np.ptp(x.torque) > 0
    ]
    return [replace(own, unit=units.unit(own.unit), units=units) for own in found]


def find_regions(
    x: Samples,
    residual: Array,
    noise: float,
    axes: Sequence[str] = tuple(SYMBOLS),
    most: int = 6,
    units: JointUnits = TURNING,
) -> list[Region]:
    """Find regions with a mean residual above five standard errors, the most significant first.

    Each finding is told once: over the quantity whose profile tells most of it for the number of its bins, or as a
    constant; over others, what that leaves. Where each finding shows most comes first.
    """
    places: list[Region] = []
    more: list[Region] = []
    left, first = np.asarray(residual, dtype=float), 0.0
    for _ in range(len(axes) + 1):
        laws = [
            law
            for law in (_make_constant_profile(x, left, noise, units), *compute_profiles(x, left, noise, axes, units))
            if _find_profile_regions(law)
        ]
        law = max(laws, key=compute_significance, default=None)
        if law is None or compute_significance(law) < REGIONS.share * first:
            break
        place, *others = _find_profile_regions(law)
        places, more, first = [*places, place], [*more, *others], first or compute_significance(law)
        left = left - _evaluate_profile(law, x, left)
    return [*places, *more][:most]


def _make_constant_profile(x: Samples, residual: Array, noise: float, units: JointUnits) -> Profile:
    """Compute the mean as a profile with one bin over all times."""
    edges = np.array([np.min(x.time), np.max(x.time)], dtype=float)
    mean, error = np.array([residual.mean()]), np.array([noise / np.sqrt(len(residual))])
    return Profile("time", "s", edges, mean, error, units)


def compute_significance(law: Profile) -> float:
    """Compute the significance of a profile: its sum of squares relative to the noise, minus two per parameter."""
    squares = (law.mean / np.maximum(law.error, 1e-12)) ** 2
    if law.axis == "frequency":  # one tone, the largest of many
        return float(squares.max() - 2 * (2 + np.log(len(squares))))
    return float(squares.sum() - 2 * len(squares))


def _evaluate_profile(law: Profile, x: Samples, residual: Array) -> Array:
    """Evaluate a profile at each row of the residual (R,) [N m]."""
    if law.axis == "frequency":
        peak = int(np.argmax(law.mean))
        phase = np.pi * (law.edges[peak] + law.edges[peak + 1]) * np.asarray(x.time)
        tone = np.column_stack([np.cos(phase), np.sin(phase)])
        return np.asarray(tone @ np.linalg.lstsq(tone, residual, rcond=None)[0])
    values = np.asarray(getattr(x, law.axis))
    return np.asarray(law.mean[_make_bins(wrap_angles(values) if law.unit == WITHIN else values, law.edges)])


def _find_profile_regions(item: Profile) -> list[Region]:
    """Find significant intervals of a profile, the most significant first; of a spectrum, its peak."""
    score = np.abs(item.mean) / np.maximum(item.error, 1e-12)
    signs = np.sign(item.mean) * (score > REGIONS.stands_out)
    if item.axis == "frequency":
        signs = np.where(np.arange(len(score)) == np.argmax(score), signs, 0)
    regions = []
    for part in np.split(np.arange(len(signs)), np.flatnonzero(np.diff(signs)) + 1):
        if signs[part[0]] == 0:
            continue
        weight = 1 / np.maximum(item.error[part], 1e-12) ** 2
        mean = float(np.average(item.mean[part], weights=weight))
        sigma = abs(mean) * float(np.sqrt(weight.sum()))
        low, high = float(item.edges[part[0]]), float(item.edges[part[-1] + 1])
        unit = item.unit if len(item.mean) > 1 else ""  # a constant has none
        regions.append(Region(item.axis, low, high, mean, sigma, unit, units=item.units))
    return sorted(regions, key=lambda region: -region.significance)
