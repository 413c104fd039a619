"""Hints for the search over nonlinear parameters of effects: initial grids and physical conditions.

Default hints follow from the law of an effect. Effects of the library have better hints in `_HINTS`. Users set hints of
other effects by `set_hints`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from estimators.signals.motion import compute_fast_speed
from pendulum_env._typing import Array
from pendulum_env.physics import ByTime, NonlinearParameter, Samples, Term
from pendulum_env.physics.actuation import ActuatorLag, DeadTime, TorqueRipple, TorqueSaturation
from pendulum_env.physics.effect_check import check_variants
from pendulum_env.physics.friction import LoadDependentFriction, Presliding, Stribeck, TemperatureDependentFriction
from pendulum_env.physics.limits import clip_term
from pendulum_env.physics.potential import Cogging, HardStop, Spring
from pendulum_env.physics.sensor import EncoderEccentricity
from pendulum_env.physics.table import OF_ANGLE, ByAngle, Extent, FrictionBySpeed, PowerOfSpeed
from pendulum_env.physics.time_varying import FrictionDrift, PayloadChange, PeriodicDisturbance
from pendulum_env.physics.transmission import Backlash, JointFlexibility

# Arguments: a class of terms, N samples of the motion, and the unexplained torque (N,) [N m].
Grid = Callable[[type[Any], Samples, Array], Iterable[Term]]

VARIANTS = 36  # number of variants of a grid over the bounds of all nonlinear parameters
MOST_ORDERS = 400  # largest number of trial values of a single integer parameter
COARSE = 60  # cogging: largest order of a complete search
FINEST, STARTS = 400, 3  # cogging: highest order, twice the ratio of usual gears; number of trial orders above COARSE
WAVES = 3  # cogging: least number of periods of the longest of several waves within the motion
WARMER = 1.0  # [K], least change of the temperature
PEAKS = 8  # number of highest peaks of a periodogram from which a search starts
ANGLES, SPEEDS = (6, 12, 24, 48), (4, 8, 16)  # trial numbers of pieces of tables
LEAST_SAMPLES = 0.01  # of a piece of a table by angle, share of all samples: fewer determine no piece


def make_grid_over_bounds(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """Spread about `VARIANTS` variants over the bounds of the nonlinear parameters; an instant lies within the motion.

    Parameters that have a nominal value or follow another parameter keep their default. Variants with a fault are left
    out.
    """
    searched = [
        parameter for parameter in kind.nonlinear_parameters if parameter.nominal is None and not parameter.follows
    ]
    count = max(2, int(VARIANTS ** (1.0 / max(len(searched), 1))))
    axes = [
        _spread(parameter, count if len(searched) > 1 or not parameter.integer else MOST_ORDERS, x)
        for parameter in searched
    ]
    names = [parameter.name for parameter in searched]
    variants = [kind(), *(kind(**dict(zip(names, values, strict=True))) for values in product(*axes))]
    return list(dict.fromkeys(variant for variant in variants if not variant.fault))


def _spread(parameter: NonlinearParameter, count: int, x: Samples) -> list[float]:
    """Spread values of a parameter over its bounds, geometrically if positive; none if a bound is infinite."""
    low, high = parameter.low, parameter.high
    if parameter.instant:
        low, high = max(low, float(np.min(x.time))), min(high, float(np.max(x.time)))
    if not np.isfinite([low, high]).all():
        return []
    if parameter.integer:
        return np.unique(np.round(np.linspace(low, high, min(count, int(high - low) + 1)))).tolist()
    values: list[float] = (np.geomspace if low > 0 else np.linspace)(low, high, count).tolist()
    return values


def _accept_all(term: Any, x: Samples) -> bool:
    return True


@dataclass(frozen=True)
class SearchHints:
    """Hints for the search over one effect; the defaults follow from its law.

    Attributes:
        grid: function that lists variants as starts of the search.
        n_tried: function that counts the variants that the grid compares with the residual; by default those listed.
        is_possible: whether nonlinear parameters of a term are plausible for the motion in N samples.
        alternative_starts: starts of released nonlinear parameters by name, other than their nominal values; without
            starts, the grid has all values to try.
        multimodal: nonlinear parameter over which the error of torque has many local minima; all are searched.
        profiled: nonlinear parameter over which the error of rollouts has many local minima; its standard error is the
            interval of the profile likelihood.
    """

    grid: Grid = make_grid_over_bounds
    n_tried: Callable[[type[Any], Samples, Array], int] | None = None
    is_possible: Callable[[Any, Samples], bool] = _accept_all
    alternative_starts: Mapping[str, float] = field(default_factory=dict)
    multimodal: str = ""
    profiled: str = ""


def set_hints(kind: type[Term], hints: SearchHints) -> None:
    """Set the hints for the search over an effect, also at a joint or within limits.

    Raises:
        UserError: if the grid or a law of its variants fails on a test motion.
    """
    check_variants(f"grid of {kind.__name__}", lambda x: hints.grid(kind, x, x.torque))
    _HINTS[kind] = hints


def find_hints(kind: type[Term]) -> SearchHints:
    """Return the hints for an effect, or those of its base class."""
    return next((_HINTS[base] for base in kind.__mro__ if base in _HINTS), SearchHints())


def make_grid(kind: type[Term], x: Samples, residual: Array) -> list[Term]:
    """List variants of an effect as starts of a search, within the bounds of its parameters.

    `residual` is the unexplained torque in the samples (N,) [N m].
    """
    return list(dict.fromkeys(iterate_grid(kind, x, residual)))


def iterate_grid(kind: type[Term], x: Samples, residual: Array) -> Iterator[Term]:
    """Yield the variants of `make_grid` one by one; variants with equal values after clipping are repeated."""
    return map(clip_term, find_hints(kind).grid(kind, x, residual))


def count_variants(kind: type[Term], x: Samples, residual: Array) -> int:
    """Count the variants that `make_grid` has compared with the residual, or else lists."""
    count = find_hints(kind).n_tried
    return len(make_grid(kind, x, residual)) if count is None else count(kind, x, residual)


def is_possible(term: Term, x: Samples) -> bool:
    """Return whether the nonlinear parameters of a term are plausible for the motion in N samples."""
    return find_hints(type(term)).is_possible(term, x)


def _find_peak(x: Samples) -> float:
    """Return the 99th percentile of the absolute torque [N m]."""
    return float(np.percentile(np.abs(x.torque), 99))


def _list_torque_limits(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    peak = _find_peak(x)
    corners = (1.0, 0.2) if peak > 0 else ()
    return [kind(float(limit), corner) for corner in corners for limit in np.geomspace(0.2 * peak, 12 * peak, 16)]


def _is_saturation(term: TorqueSaturation, x: Samples) -> bool:
    """Require a limit of at least 15 % of the peak torque: a lower limit removes nearly all torque to explain."""
    return bool(term.limit >= 0.15 * _find_peak(x))


def _list_stribeck_velocities(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List ten Stribeck velocities, from a 60th to half of the fast speed."""
    fast = max(compute_fast_speed(x.velocity), 1e-6)
    return [kind(float(vs)) for vs in np.geomspace(fast / 60, fast / 2, 10)]


def _is_stribeck(term: Stribeck, x: Samples) -> bool:
    """Require a Stribeck velocity within the reached speeds, where its friction differs from dry friction."""
    return bool(term.stribeck_velocity <= np.max(np.abs(x.velocity)))


def _list_cogging_orders(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List all low orders, and the strongest of the high orders of strain-wave gears."""
    n_bins = 8 * FINEST  # eight bins per wave of the highest order
    bin_of_sample = np.floor(np.asarray(x.position) / (2 * np.pi) * n_bins).astype(int) % n_bins
    power = np.abs(np.fft.rfft(np.bincount(bin_of_sample, residual, n_bins)))[COARSE + 1 : FINEST + 1]
    high_orders = COARSE + 1 + np.argsort(power)[::-1][:STARTS]
    return [kind(float(order)) for order in (*range(2, COARSE + 1), *high_orders.tolist())]


def _is_cogging(term: Cogging, x: Samples) -> bool:
    """Require `WAVES` periods of each of several waves within the motion: fewer waves can draw any curve."""
    first, *others = sorted(order for order in term.nonlinear_values.values() if order)
    return not others or bool(np.ptp(x.position) * first >= 2 * np.pi * WAVES)


def _list_stops(kind: type[Any], x: Samples, residual: Array) -> Iterator[Term]:
    """List possible stops near either end of the motion, elastic and damped.

    Depths are 0.01 to 40 % of the range. The motion meets each stop, and the joint is free at the median of its path.
    `residual` is not used.
    """
    low, median, high = _describe_path(x)
    depths = (high - low) * np.geomspace(1e-4, 0.4, 10)
    lower, upper = (low + depths).tolist(), (high - depths).tolist()
    ends = [*((stop, np.inf) for stop in lower), *((-np.inf, stop) for stop in upper), *product(lower, upper)]
    possible = [stops for stops in ends if stops[0] < median < stops[1]]
    return (kind(*stops, damping_time=damping) for damping in (0.0, 0.01, 0.04) for stops in possible)


def _is_stop(term: HardStop, x: Samples) -> bool:
    """Require that the motion meets each stop, and that the joint is free along at least half of its path.

    A torque along more than half of the path is that of a spring.
    """
    low, median, high = _describe_path(x)
    is_met = (low < term.lower or np.isinf(term.lower)) and (term.upper < high or np.isinf(term.upper))
    return bool(is_met and term.lower < median < term.upper)


def _describe_path(x: Samples) -> tuple[float, float, float]:
    """Return the lowest position of a motion, the median of its path, and the highest position."""
    order = np.argsort(x.position)
    path, q = np.cumsum(np.abs(np.asarray(x.velocity)[order])), np.asarray(x.position)[order]
    return float(q[0]), float(q[np.searchsorted(path, 0.5 * path[-1])]), float(q[-1])


def _list_warm_up_times(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List eight warm-up times, from a twentieth to one and a half of the last time."""
    span = float(np.max(x.time))
    return [kind(float(warm_up)) for warm_up in np.geomspace(span / 20, span * 1.5, 8)]


def _list_instants(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List instants in steps of 2 % of the motion, without the first and last 4 %."""
    start, stop = float(np.min(x.time)), float(np.max(x.time))
    return [kind(float(moment)) for moment in start + (stop - start) * np.arange(0.04, 0.97, 0.02)]


def _list_frequencies(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List the frequencies of the highest peaks of the periodogram of the residual."""
    omega, power = _compute_periodogram(x, residual)
    peaks = np.flatnonzero((power[1:-1] >= power[2:]) & (power[1:-1] >= power[:-2])) + 1
    highest = peaks[np.argsort(power[peaks])[::-1][:PEAKS]]
    return [kind(float(w)) for w in omega[highest]]


def _compute_periodogram(x: Samples, residual: Array) -> tuple[Array, Array]:
    """Compute the power of the residual at frequencies [rad/s], close enough to resolve every peak."""
    time = np.asarray(x.time)
    gaps = np.diff(time)
    step = float(np.median(gaps[gaps > 0])) / 2
    bins = np.round(time / step).astype(int)
    signal = np.bincount(bins - bins.min(), weights=residual)
    length = int(2 ** np.ceil(np.log2(4 * len(signal))))
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(length, step), dtype=float)
    span = float(time.max() - time.min())
    usable = (omega > 2 * np.pi / span) & (omega < 0.8 * np.pi / (2 * step))
    return omega[usable], np.abs(np.fft.rfft(signal, length))[usable] ** 2


def _list_flexible_joints(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List all combinations of 34 resonances, two dampings and three gravities, for any motion."""
    return [
        kind(float(w), float(c), g)
        for w in np.geomspace(6.0, 300.0, 34)
        for c in (0.3, 3.0)
        for g in (12.0, 25.0, 50.0)
    ]


def _list_gaps(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List all combinations of six gaps, three resonances, two dampings and two gravities, for any motion."""
    return [
        kind(float(gap), float(w), c, g)
        for gap in np.geomspace(2e-3, 0.08, 6)
        for w in (50.0, 90.0, 160.0)
        for c in (8.0, 20.0)
        for g in (15.0, 30.0)
    ]


def _list_table_angles(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List tables over the reached angles, and over a turn if the joint made a turn."""
    position, tables = np.asarray(x.position), list[Term]()
    ranges = [(position, float(position.min()), float(position.max()))]
    if np.ptp(position) >= 2 * np.pi and not kind.is_prismatic:
        ranges.append(((position + np.pi) % (2 * np.pi) - np.pi, -np.pi, np.pi))
    for angles, low, high in ranges:
        for pieces in ANGLES if low < high else ():
            merged = _list_sparse_knots(np.histogram(angles, pieces, (low, high))[0])
            if pieces - len(merged) > len(OF_ANGLE):
                tables.append(kind.with_extent(Extent(low, high, pieces, merged=merged))())
    return tables


def _list_sparse_knots(counts: Array) -> tuple[int, ...]:
    """List the inner knots to merge, so that each piece has the share `LEAST_SAMPLES` of the samples.

    `counts` are the samples of the pieces (K,).
    """
    kept, before = [0], np.append(0, np.cumsum(counts))  # samples before each knot
    for knot in range(1, len(counts)):
        if min(before[knot] - before[kept[-1]], before[-1] - before[knot]) >= LEAST_SAMPLES * before[-1]:
            kept.append(knot)
    return tuple(knot for knot in range(1, len(counts)) if knot not in kept)


def _list_table_speeds(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    fastest = float(np.max(np.abs(x.velocity)))
    return [kind.with_extent(Extent(0.0, fastest, pieces))() for pieces in SPEEDS]


def _list_table_times(kind: type[Any], x: Samples, residual: Array) -> list[Term]:
    """List a table of pieces of about `length` seconds, 2 to `most` of them."""
    first, last = float(np.min(x.time)), float(np.max(x.time))
    pieces = min(max(2, round((last - first) / kind.length)), kind.max_pieces)
    return [kind.with_extent(Extent(first, last, int(pieces)))()]


def _make_value_grid(values: Iterable[float]) -> Grid:
    """Make a grid over the first nonlinear parameter with the same values for all data."""
    numbers = [float(value) for value in values]
    return lambda kind, x, residual: [kind(number) for number in numbers]


_HINTS: dict[type[Term], SearchHints] = {
    TorqueRipple: SearchHints(_make_value_grid(range(1, 61))),
    TorqueSaturation: SearchHints(
        _list_torque_limits, is_possible=_is_saturation, alternative_starts={"roundness": 0.4}
    ),
    ActuatorLag: SearchHints(_make_value_grid(np.geomspace(1e-3, 0.2, 12))),
    DeadTime: SearchHints(_make_value_grid(np.geomspace(1e-3, 0.2, 14))),
    Stribeck: SearchHints(_list_stribeck_velocities, is_possible=_is_stribeck, alternative_starts={"exponent": 1.4}),
    LoadDependentFriction: SearchHints(
        lambda kind, x, residual: [kind(share * float(np.std(x.torque))) for share in (0.0, 1.0)]
    ),
    TemperatureDependentFriction: SearchHints(
        lambda kind, x, residual: [kind()] if np.ptp(x.temperature) > WARMER else []
    ),
    Presliding: SearchHints(_make_value_grid(np.geomspace(5e-4, 0.2, 12))),
    Cogging: SearchHints(
        _list_cogging_orders,
        n_tried=lambda kind, x, residual: FINEST - 1,
        is_possible=_is_cogging,
        alternative_starts={f"order_{k}": 2.0 for k in range(2, 6)},
    ),
    Spring: SearchHints(
        # gravity may replace the linear part of a hardening spring; gravity of a linked mechanism is that of its links
        lambda kind, x, residual: [kind()] if kind.at else [kind(), kind(3.0)],
        alternative_starts={"degree": 3.0},
    ),
    EncoderEccentricity: SearchHints(lambda kind, x, residual: [kind(), kind(order=2.0)]),
    HardStop: SearchHints(
        _list_stops, is_possible=_is_stop, alternative_starts={"hysteresis": 0.05, "damping_time": 0.005}
    ),
    FrictionDrift: SearchHints(_list_warm_up_times),
    PayloadChange: SearchHints(_list_instants),
    PeriodicDisturbance: SearchHints(
        _list_frequencies, n_tried=lambda kind, x, residual: len(_compute_periodogram(x, residual)[0])
    ),
    JointFlexibility: SearchHints(_list_flexible_joints),
    Backlash: SearchHints(_list_gaps, multimodal="resonance", profiled="gap"),
    ByAngle: SearchHints(_list_table_angles),
    FrictionBySpeed: SearchHints(_list_table_speeds),
    PowerOfSpeed: SearchHints(_make_value_grid((0.5, 1.5, 2.0, 3.0, 5.0))),
    ByTime: SearchHints(_list_table_times),
}
