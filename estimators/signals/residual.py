"""Regions of angle, velocity, torque, time and frequency with a significant residual."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.findings import Finding
from pendulum_env._typing import JSON, Array, Index
from pendulum_env.notebook import summarise
from pendulum_env.physics import Samples
from pendulum_env.quantity import get_finite
from pendulum_env.units import TURNING, JointUnits

AXES = {"position": "rad", "velocity": "rad/s", "torque": "N m", "time": "s"}
SPECTRA = {"frequency": "Hz", "order": "periods per turn"}  # over time, and over the angle
SYMBOLS = {"position": "q", "velocity": "q'", "torque": "tau", "time": "t", "frequency": "f", "order": "n"}


@dataclass(frozen=True)
class RegionSettings:
    """Settings of profiles, and limits of significant regions."""

    bins: int = 24  # least number of bins of a profile with enough data, and the number over time
    most_bins: int = 384  # largest number of bins; between both, the number doubles while the data resolve more
    rows: int = 8  # least number of rows of a bin
    lines: int = 399  # largest number of frequencies or orders of a spectrum
    turns: float = 2.0  # range of the angle above which it is wrapped to one turn [turns]
    tone: float = 0.9  # significance from which one tone or a constant is preferred to bins, relative to theirs
    z_limit: float = 5.0  # least mean residual of a region [standard errors]


REGIONS = RegionSettings()
WITHIN = "rad within a turn"  # unit of wrapped angles


@dataclass(frozen=True)
class Profile:
    """Mean residual over one quantity, in bins of about equal count; over frequency and order, a spectrum.

    Attributes:
        axis: key of `SYMBOLS`.
        unit: unit of the axis.
        edges: limits of the bins (K + 1,), in `unit`.
        mean: mean residual in each bin (K,) [N m]; of a spectrum the amplitude.
        error: standard error of the mean by noise alone (K,) [N m].
        units: names of the joint's units.
        negligible: mean residual without meaning [N m].
    """

    axis: str
    unit: str
    edges: Array
    mean: Array
    error: Array
    units: JointUnits = TURNING
    negligible: float = 0.0

    @property
    def middle(self) -> Array:
        """Return the middle of each bin (K,), in `unit`."""
        return 0.5 * (self.edges[1:] + self.edges[:-1])

    @property
    def band(self) -> Array:
        """Return the limit of an insignificant mean in each bin (K,) [N m]."""
        return np.maximum(REGIONS.z_limit * self.error, self.negligible)

    @property
    def is_spectrum(self) -> bool:
        """Return whether the profile has amplitudes, over frequency or order."""
        return self.axis in SPECTRA


@dataclass(frozen=True)
class Region:
    """Interval of one axis with a significant residual.

    Attributes:
        axis: key of `SYMBOLS`.
        low, high: ends of the interval, in `unit`.
        residual: mean residual of its bins [N m]; of a spectrum their largest amplitude.
        significance: absolute residual over its standard error by noise.
        unit: unit of the axis; empty for a constant.
        at: name of the joint; empty for a pendulum.
        units: names of the joint's units.
        is_profiled: whether the interval comes from a profile; else the residual is not limited to it.
        held_out_recordings: names of the recordings, if only held-out data have the residual.
        cause: finding that explains the residual, or None.
        peak: place of the largest amplitude of a spectrum, in `unit`, else None.
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
    peak: float | None = None

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
            "peak": self.peak,
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
    """Return the profile of a residual (R,) [N m] over `values` (R,), in bins of about equal count.

    The number of bins follows the data, see `_choose_bins`; over time it is fixed, as the spectrum shows fast changes.
    No bin has velocities of both directions. `axis` is a key of `AXES`, and `noise` the standard deviation of each
    residual by noise alone [N m]. Angles of a joint that makes whole turns are wrapped to one turn.
    """
    is_wrapped = axis == "position" and makes_whole_turns(values)
    values, unit = (wrap_angles(values), WITHIN) if is_wrapped else (np.asarray(values), AXES[axis])
    edges = _choose_bins(values, residual, REGIONS.bins if axis == "time" else REGIONS.most_bins)
    if axis == "velocity" and edges[0] < 0 < edges[-1]:  # friction has the opposite sign on the other side
        nearest = 1 + int(np.argmin(np.abs(edges[1:-1])))
        edges = np.unique(np.append(np.delete(edges, nearest), 0.0))
        edges = np.append(edges[:-1][np.histogram(values, edges)[0] > 0], edges[-1])
    mean, counts = _average_bins(values, residual, edges)
    return Profile(axis, unit, edges, mean, noise / np.sqrt(counts))


def _choose_bins(values: Array, residual: Array, most: int) -> Array:
    """Return the edges (K + 1,) of at most `most` bins of equal count that explain a residual (R,) best.

    K minimises R ln(sum (r - mean of its bin)^2) + K ln R, the Bayesian information criterion, among doubled numbers
    and the largest. The scatter of the residual itself decides, so another structure in it needs no bins.

    Source: Schwarz, Annals of Statistics 6, 1978.
    """
    largest = max(2, min(most, len(values) // REGIONS.rows))
    doubled = (REGIONS.bins * 2**k for k in range(most // REGIONS.bins))
    best, least = np.empty(0), np.inf
    for count in sorted({largest, *(count for count in doubled if count < largest)}):
        edges = np.quantile(values, np.linspace(0, 1, count + 1))
        mean, counts = _average_bins(values, residual, edges)
        rest = max(float(residual @ residual - counts @ mean**2), np.finfo(float).tiny)
        criterion = len(residual) * np.log(rest) + count * np.log(len(residual))
        if criterion < least:
            best, least = edges, criterion
    return best


def _average_bins(values: Array, residual: Array, edges: Array) -> tuple[Array, Array]:
    """Return the mean residual (K,) of the rows in each bin, and their number (K,), at least 1."""
    bin_of_row = _find_bins(values, edges)
    counts = np.maximum(np.bincount(bin_of_row, minlength=len(edges) - 1), 1)
    return np.bincount(bin_of_row, weights=residual, minlength=len(edges) - 1) / counts, counts


def _find_bins(values: Array, edges: Array) -> Array:
    """Return the bin of each value (R,), from 0 to K - 1; values outside the edges (K + 1,) are in the outer bins."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def compute_spectrum(time: Array, residual: Array, noise: float) -> Profile:
    """Return the spectrum of a residual (R,) [N m] at times (R,) [s] by Lomb-Scargle, as windows may be missing.

    Its frequencies are multiples of one over the duration, up to 0.4 of the window rate. `noise` is the standard
    deviation of each residual by noise alone [N m].

    Source: Scargle, Astrophysical Journal 263, 1982.
    """
    span = float(np.ptp(time)) or 1.0
    step = float(np.median(np.diff(np.unique(time))))
    lines = np.arange(1, max(2, min(REGIONS.lines + 1, int(0.4 * span / step)))) / span
    return _fit_spectrum("frequency", time, lines, 1 / span, residual, noise)


def compute_order_spectrum(position: Array, residual: Array, noise: float) -> Profile | None:
    """Return the spectrum of a residual (R,) [N m] over the angle (R,) [rad]: amplitude against periods per turn.

    The first order has one period in the range of the angle, the last 2.5 samples a period at the typical speed.
    None if no order is between them.
    """
    turns = np.asarray(position) / (2 * np.pi)
    step = float(np.median(np.abs(np.diff(turns))))
    first, last = np.ceil(1 / max(np.ptp(turns), 1e-12)), min(REGIONS.lines, 0.4 / max(step, 1e-12))
    if first > last:
        return None
    return _fit_spectrum("order", turns, np.arange(first, last + 1), 1.0, residual, noise)


def _fit_spectrum(axis: str, values: Array, lines: Array, width: float, residual: Array, noise: float) -> Profile:
    """Fit a tone of each of the lines (K,), `width` apart, to a residual (R,) over values (R,) without its mean."""
    centered = residual - residual.mean()
    amplitude = np.array([_fit_amplitude(values, centered, 2 * np.pi * line) for line in lines])
    edges = np.r_[lines - 0.5 * width, lines[-1] + 0.5 * width]
    return Profile(axis, SPECTRA[axis], edges, amplitude, np.full(len(lines), noise * np.sqrt(2 / len(residual))))


def _fit_amplitude(values: Array, residual: Array, omega: float) -> float:
    """Fit a cosine and a sine of omega to a residual (R,) over values (R,); return the amplitude of their sum.

    It is sqrt(4 P / R) of the power P by `scipy.signal.lombscargle`; importing that takes half a second.
    """
    wave = np.exp(1j * omega * values)
    overlap = np.mean(wave**2)  # half its phase makes cosine and sine orthogonal
    share = np.mean(residual * wave) * np.exp(-0.5j * np.angle(overlap))
    size = abs(overlap)
    return float(2 * np.sqrt(share.real**2 / (1 + size) + share.imag**2 / max(1 - size, np.finfo(float).eps)))


def compute_profiles(
    x: Samples,
    residual: Array,
    noise: float,
    axes: Sequence[str] = tuple(SYMBOLS),
    units: JointUnits = TURNING,
    negligible: float = 0.0,
) -> list[Profile]:
    """Compute the profile of a residual (R,) over each of some axes, keys of `SYMBOLS`; see `compute_profile`.

    Frequency and order give spectra. Torque is left out if it is constant, order if no range of it is resolved, and at
    a linear joint. A mean below `negligible` [N m] has no meaning.
    """

    def compute(axis: str) -> Profile | None:
        if axis == "frequency":
            return compute_spectrum(np.asarray(x.time), residual, noise)
        if axis == "order":
            return None if units.is_prismatic else compute_order_spectrum(np.asarray(x.position), residual, noise)
        values = np.asarray(getattr(x, axis))
        return compute_profile(axis, values, residual, noise) if axis != "torque" or np.ptp(values) > 0 else None

    profiles = [profile for axis in axes if (profile := compute(axis)) is not None]
    return [replace(p, unit=units.unit(p.unit), units=units, negligible=negligible) for p in profiles]


def find_regions(profiles: Sequence[Profile]) -> list[Region]:
    """Return the runs of all profiles of one residual, the most significant first; see `find_runs`.

    Amplitudes of a spectrum come after means, unless `find_strongest` returns the spectrum. Runs over all bins of an
    axis are one region, a constant residual, if its mean is nearly as significant as the strongest profile; else the
    residual depends on another quantity, and they come after the other means. A constant is also the only region if
    the mean of all rows is significant, but no bin is.
    """
    strongest, whole = find_strongest(profiles), {p.axis: (p.edges[0], p.edges[-1]) for p in profiles}
    runs = [(run, (run.low, run.high) == whole[run.axis]) for profile in profiles for run in find_runs(profile)]
    time = next((profile for profile in profiles if profile.axis == "time"), None)
    if time is not None and (not runs or any(is_whole for _, is_whole in runs)):
        constant = replace(_make_region(time, np.arange(len(time.mean))), unit="")
        is_alone = not runs or constant.significance**2 > REGIONS.tone * compute_significance(strongest)
        if is_alone and constant.significance > REGIONS.z_limit and abs(constant.residual) > time.negligible:
            runs = [(run, False) for run, is_whole in runs if not is_whole] + [(constant, False)]

    def rank(item: tuple[Region, bool]) -> tuple[bool, bool, float]:
        run, is_whole = item
        is_other = run.axis != strongest.axis
        return run.axis in SPECTRA and is_other, is_whole and is_other, -run.significance

    return [run for run, _ in sorted(runs, key=rank)]


def split_regions(profiles: Sequence[Profile]) -> tuple[list[Region], list[Region]]:
    """Return the regions of profiles, and those of spectra, which show the means again if a mean is the strongest."""
    regions, is_tone = find_regions(profiles), find_strongest(profiles).is_spectrum
    means = [region for region in regions if is_tone or region.axis not in SPECTRA] or regions
    return means, regions[len(means) :]


def find_runs(profile: Profile) -> list[Region]:
    """Return each run of neighbouring bins of a profile whose means leave their bands to the same side."""
    is_beyond = np.abs(profile.mean) > profile.band
    return [_make_region(profile, bins) for bins in split_bins(profile) if is_beyond[bins[0]]]


def split_bins(profile: Profile) -> list[Index]:
    """Split the bins of a profile into runs, within their bands or beyond them to one side."""
    sides = np.sign(profile.mean) * (np.abs(profile.mean) > profile.band)
    return np.split(np.arange(len(sides)), np.flatnonzero(np.diff(sides)) + 1)


def _make_region(profile: Profile, bins: Index) -> Region:
    """Make the region of neighbouring bins of a profile, with their mean, or with the largest amplitude."""
    low, high = float(profile.edges[bins[0]]), float(profile.edges[bins[-1] + 1])
    means, errors = profile.mean[bins], np.maximum(profile.error[bins], 1e-12)
    if profile.is_spectrum:
        k = int(np.argmax(means))
        mean, error, peak = float(means[k]), float(errors[k]), float(profile.middle[bins[k]])
    else:
        mean, error, peak = float(means.mean()), float(np.sqrt(errors @ errors)) / len(bins), None
    return Region(profile.axis, low, high, mean, abs(mean) / error, profile.unit, units=profile.units, peak=peak)


def compute_significance(profile: Profile) -> float:
    """Return the gain in AIC of a profile over zero: the sum of (mean / error)^2, minus two per bin.

    For a spectrum, the largest square minus 2 (2 + ln K): one tone of K lines, with two parameters.
    """
    squares = (profile.mean / np.maximum(profile.error, 1e-12)) ** 2
    if profile.is_spectrum:
        return float(squares.max() - 2 * (2 + np.log(len(squares))))
    return float(squares.sum() - 2 * len(squares))


def find_strongest(profiles: Sequence[Profile]) -> Profile:
    """Return the most significant profile, or a spectrum whose one tone is nearly as significant."""
    gains = {profile.axis: compute_significance(profile) for profile in profiles}
    least = REGIONS.tone * max(gains.values())
    return max(profiles, key=lambda profile: (profile.is_spectrum and gains[profile.axis] > least, gains[profile.axis]))


def remove_strongest(profiles: Sequence[Profile], x: Samples, residual: Array) -> tuple[Profile, Array]:
    """Return the strongest profile of a residual (R,) [N m], and the residual without it (R,).

    Of a spectrum the tone at its peak is removed.
    """
    top = find_strongest(profiles)
    if top.is_spectrum:
        values = np.asarray(x.position if top.axis == "order" else x.time)
        phase = (1 if top.axis == "order" else 2 * np.pi) * top.middle[np.argmax(top.mean)] * values
        tone = np.column_stack([np.cos(phase), np.sin(phase)])
        return top, residual - np.asarray(tone @ np.linalg.lstsq(tone, residual, rcond=None)[0])
    return top, residual - top.mean[_find_bins(_get_values(top, x), top.edges)]


def average_alike(profile: Profile, x: Samples, series: Array) -> Profile:
    """Return the profile of another series (R,) in the bins of a profile that is no spectrum."""
    return replace(profile, mean=_average_bins(_get_values(profile, x), series, profile.edges)[0])


def _get_values(profile: Profile, x: Samples) -> Array:
    """Return the samples (R,) of the quantity of a profile that is no spectrum."""
    values = np.asarray(getattr(x, profile.axis))
    return wrap_angles(values) if profile.unit == WITHIN else values
