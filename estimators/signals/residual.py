"""Regions of angle, velocity, torque, time and frequency with a significant residual."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.findings import Finding
from pendulum_env._typing import JSON, Array
from pendulum_env.notebook import summarise
from pendulum_env.physics import Samples
from pendulum_env.quantity import get_finite
from pendulum_env.units import TURNING, JointUnits

AXES = {"position": "rad", "velocity": "rad/s", "torque": "N m", "time": "s"}
SYMBOLS = {"position": "q", "velocity": "q'", "torque": "tau", "time": "t", "frequency": "f"}


@dataclass(frozen=True)
class RegionSettings:
    """Settings of profiles, and limits of significant regions."""

    bins: int = 24  # largest number of bins of a profile
    turns: float = 2.0  # range of the angle above which it is wrapped to one turn [turns]
    fine: int = 4  # factor on the bins of wrapped angles, to resolve periodic torque
    share: float = 0.03  # least significance of a further profile, relative to the first
    z_limit: float = 5.0  # least mean residual of a region [standard errors]


REGIONS = RegionSettings()
WITHIN = "rad within a turn"  # unit of wrapped angles


@dataclass(frozen=True)
class Profile:
    """Mean residual over one quantity, in bins of equal count; over frequency, a spectrum.

    Attributes:
        axis: key of `SYMBOLS`.
        unit: unit of the axis.
        edges: limits of the bins (K + 1,), in `unit`.
        mean: mean residual in each bin (K,) [N m]; over frequency the amplitude.
        error: standard error of the mean by noise alone (K,) [N m].
        units: names of the joint's units.
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
        axis: key of `SYMBOLS`.
        low, high: ends of the interval, in `unit`.
        residual: mean residual [N m]; over frequency the amplitude.
        significance: absolute mean over its standard error by noise.
        unit: unit of the axis; empty for a constant.
        at: name of the joint; empty for a pendulum.
        units: names of the joint's units.
        is_profiled: whether the interval comes from a profile; else the residual is not limited to it.
        held_out_recordings: names of the recordings, if only held-out data have the residual.
        cause: finding that explains the residual, or None.
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
    held_out_recordings: tuple[str, ...] = ()
    cause: Finding | None = None

    def __str__(self) -> str:
        return summarise(self)

    @property
    def is_constant(self) -> bool:
        """Return whether the residual is constant: over time, without a unit."""
        return self.axis == "time" and not self.unit

    @property
    def kind(self) -> str:
        """Return the family of the cause, or the axis."""
        return self.cause.family if self.cause is not None else self.axis

    def json(self) -> JSON:
        """Return a dictionary for JSON; an infinite limit becomes null, and `unit` belongs to the axis."""
        return {
            "joint": self.at,
            "axis": self.axis,
            "low": get_finite(self.low),
            "high": get_finite(self.high),
            "unit": self.unit,
            "residual": self.residual,
            "significance": self.significance,
            "held_out": [*self.held_out_recordings],
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
    """Make the region of a residual that is not limited to an interval: all velocities of the samples.

    `size` is the residual and `floor` the noise floor of the joint `at` [N m]. Without samples it is unlimited.
    """
    fast = np.inf if x is None else float(np.abs(x.velocity).max())
    return Region(
        "velocity", -fast, fast, size, size / floor, units.unit("rad/s"), at, units, is_profiled=False, cause=cause
    )


def makes_whole_turns(position: Array) -> bool:
    """Return whether the angle (R,) [rad] spans more than `REGIONS.turns` turns."""
    return bool(np.ptp(position) > REGIONS.turns * 2 * np.pi)


def wrap_angles(position: Array) -> Array:
    """Wrap angles (N,) to the range from -pi to pi [rad]."""
    return (np.asarray(position) + np.pi) % (2 * np.pi) - np.pi


def compute_profile(axis: str, values: Array, residual: Array, noise: float) -> Profile:
    """Return the profile of a residual (R,) [N m] over `values` (R,), in bins of equal count.

    `axis` is a key of `AXES`, and `noise` the standard deviation of each residual by noise alone [N m]. Angles of a
    joint that makes whole turns are wrapped to one turn.
    """
    is_wrapped = axis == "position" and makes_whole_turns(values)
    values, unit = (wrap_angles(values), WITHIN) if is_wrapped else (np.asarray(values), AXES[axis])
    count = max(2, min(REGIONS.bins * (REGIONS.fine if is_wrapped else 1), len(values) // 8))
    edges = np.quantile(values, np.linspace(0, 1, count + 1))
    bin_of_row = _find_bins(values, edges)
    counts = np.maximum(np.bincount(bin_of_row, minlength=count), 1)
    mean = np.bincount(bin_of_row, weights=residual, minlength=count) / counts
    return Profile(axis, unit, edges, mean, noise / np.sqrt(counts))


def _find_bins(values: Array, edges: Array) -> Array:
    """Return the bin of each value (R,), from 0 to K - 1; values outside the edges (K + 1,) are in the outer bins."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def compute_spectrum(time: Array, residual: Array, noise: float) -> Profile:
    """Return the spectrum of a residual (R,) [N m] at times (R,) [s] by Lomb-Scargle, as windows may be missing.

    It has at most 399 frequencies, multiples of one over the duration, up to 0.4 of the window rate. `noise` is the
    standard deviation of each residual by noise alone [N m].

    Source: Scargle, Astrophysical Journal 263, 1982.
    """
    span = float(np.ptp(time)) or 1.0
    step = float(np.median(np.diff(np.unique(time))))
    frequency = np.arange(1, max(2, min(400, int(0.4 * span / step)))) / span
    amplitude = np.array([_fit_amplitude(time, residual, 2 * np.pi * hertz) for hertz in frequency])
    edges = np.r_[frequency - 0.5 / span, frequency[-1] + 0.5 / span]
    return Profile("frequency", "Hz", edges, amplitude, np.full(len(frequency), noise * np.sqrt(2 / len(residual))))


def _fit_amplitude(time: Array, residual: Array, omega: float) -> float:
    """Fit a cosine and a sine of omega [rad/s] to a residual (R,) at times (R,) [s]; return the amplitude of their sum.

    It is sqrt(4 P / R) of the power P by `scipy.signal.lombscargle`; importing that takes half a second.
    """
    wave = np.exp(1j * omega * time)
    overlap = np.mean(wave**2)  # half its phase makes cosine and sine orthogonal
    share = np.mean(residual * wave) * np.exp(-0.5j * np.angle(overlap))
    size = abs(overlap)
    return float(2 * np.sqrt(share.real**2 / (1 + size) + share.imag**2 / max(1 - size, np.finfo(float).eps)))


def compute_profiles(
    x: Samples, residual: Array, noise: float, axes: Sequence[str] = tuple(SYMBOLS), units: JointUnits = TURNING
) -> list[Profile]:
    """Compute the profile of a residual (R,) over each of some axes, keys of `SYMBOLS`; see `compute_profile`.

    Frequency gives the spectrum. Torque is left out if it is constant.
    """
    profiles = [
        compute_spectrum(np.asarray(x.time), residual, noise)
        if axis == "frequency"
        else compute_profile(axis, np.asarray(getattr(x, axis)), residual, noise)
        for axis in axes
        if axis != "torque" or np.ptp(x.torque) > 0
    ]
    return [replace(profile, unit=units.unit(profile.unit), units=units) for profile in profiles]


def find_regions(
    x: Samples,
    residual: Array,
    noise: float,
    axes: Sequence[str] = tuple(SYMBOLS),
    most: int = 6,
    units: JointUnits = TURNING,
) -> list[Region]:
    """Find at most `most` regions with a mean residual above five standard errors.

    The most significant profile, or a constant, is subtracted from the residual (R,) [N m]. This repeats until no
    profile is significant and exceeds `REGIONS.share` of the first. The top region of each profile comes first, then
    the others. `noise` is the standard deviation of each residual by noise alone [N m].
    """
    main: list[Region] = []
    further: list[Region] = []
    remaining, largest = np.asarray(residual, dtype=float), 0.0
    for _ in range(len(axes) + 1):
        profiles = [
            profile
            for profile in [
                _make_constant_profile(x, remaining, noise, units),
                *compute_profiles(x, remaining, noise, axes, units),
            ]
            if _find_profile_regions(profile)
        ]
        top = max(profiles, key=compute_significance, default=None)
        if top is None or compute_significance(top) < REGIONS.share * largest:
            break
        region, *others = _find_profile_regions(top)
        main, further, largest = [*main, region], [*further, *others], largest or compute_significance(top)
        remaining = remaining - _evaluate_profile(top, x, remaining)
    return [*main, *further][:most]


def _make_constant_profile(x: Samples, residual: Array, noise: float, units: JointUnits) -> Profile:
    """Return the mean residual as a profile over time with one bin."""
    edges = np.array([np.min(x.time), np.max(x.time)], dtype=float)
    mean, error = np.array([residual.mean()]), np.array([noise / np.sqrt(len(residual))])
    return Profile("time", "s", edges, mean, error, units)


def compute_significance(profile: Profile) -> float:
    """Return the gain in AIC of a profile over zero: the sum of (mean / error)^2, minus two per bin.

    For a spectrum, the largest square minus 2 (2 + ln K): one tone of K frequencies, with two parameters.
    """
    squares = (profile.mean / np.maximum(profile.error, 1e-12)) ** 2
    if profile.axis == "frequency":
        return float(squares.max() - 2 * (2 + np.log(len(squares))))
    return float(squares.sum() - 2 * len(squares))


def _evaluate_profile(profile: Profile, x: Samples, residual: Array) -> Array:
    """Return the value of a profile at each of the samples (R,) [N m]; of a spectrum, the tone fitted at its peak."""
    if profile.axis == "frequency":
        peak = int(np.argmax(profile.mean))
        phase = np.pi * (profile.edges[peak] + profile.edges[peak + 1]) * np.asarray(x.time)
        tone = np.column_stack([np.cos(phase), np.sin(phase)])
        return np.asarray(tone @ np.linalg.lstsq(tone, residual, rcond=None)[0])
    values = np.asarray(getattr(x, profile.axis))
    values = wrap_angles(values) if profile.unit == WITHIN else values
    return np.asarray(profile.mean[_find_bins(values, profile.edges)])


def _find_profile_regions(profile: Profile) -> list[Region]:
    """Return runs of significant bins of one sign of a profile, the most significant first; of a spectrum, its peak."""
    score = np.abs(profile.mean) / np.maximum(profile.error, 1e-12)
    signs = np.sign(profile.mean) * (score > REGIONS.z_limit)
    if profile.axis == "frequency":
        signs = np.where(np.arange(len(score)) == np.argmax(score), signs, 0)
    regions = []
    for bins in np.split(np.arange(len(signs)), np.flatnonzero(np.diff(signs)) + 1):
        if signs[bins[0]] == 0:
            continue
        weight = 1 / np.maximum(profile.error[bins], 1e-12) ** 2
        mean = float(np.average(profile.mean[bins], weights=weight))
        significance = abs(mean) * float(np.sqrt(weight.sum()))
        low, high = float(profile.edges[bins[0]]), float(profile.edges[bins[-1] + 1])
        unit = profile.unit if len(profile.mean) > 1 else ""  # a constant has none
        regions.append(Region(profile.axis, low, high, mean, significance, unit, units=profile.units))
    return sorted(regions, key=lambda region: -region.significance)
