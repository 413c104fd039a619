"""Six regressor models of one pendulum, which convert measurements and terms into a linear regression.

They use three views of the torque balance tau = sum_k theta_k (mass_k q'' + force_k + dry_k sgn q'):

    torque   at an instant                                  dynamic
    impulse  mean torque over a sample, from momentum       hamiltonian, filtered_dynamic, filtered_hamiltonian
    energy   mean power over a sample, from stored energy   energy, filtered_power

Momentum and stored energy enter by their increments, so a mass that jumps in time does no work. A gate leaves out
stick: the balance times any gate is still a balance. F = lambda / (s + lambda) acts on both sides of the gated balance.
It starts from rest and needs no warm-up, at the start or after stick.

With the bilinear rule for F, lambda (1 - F) p = F p' without differentiating p: lambda (1 - F) of a running sum is
the exponential average of its increments. The filtered schemes are computed by this average.

Differences from the paper: samples in stick are left out, because dry friction at rest is any torque up to fc. Eq. (9)
lacks a factor 1/2 and the grouping of its derivative. The paper's Hamiltonian pair borrows the inertia of the dynamic
pair, an option here (`PAPER`), since momentum is also linear in the parameters.

Related work: arXiv 2602.16358 (2026) uses energy-based regressors to distinguish nonlinear friction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from estimators.arguments import convert_to_tuple
from estimators.regression.least_squares import Equations
from estimators.signals.measurements import Measurements, add_states
from pendulum_env._typing import Array, Mask
from pendulum_env.filters import filter_lag
from pendulum_env.lookup import find
from pendulum_env.physics import LOAD, Column, Term
from pendulum_env.reading import quote_value

CUTOFF = 200.0  # lambda [rad/s], the paper's 31.83 Hz

View = Callable[[Measurements, Column], Array]


class Regression(NamedTuple):
    """Equations of N samples, and the mask of usable equations (N,)."""

    equations: Equations
    usable: Mask


class Regressor(Protocol):
    """Interface of a scheme for `identify`: one of the six, or a scheme of the user."""

    @property
    def id(self) -> str:
        """Return the name in files and on the command line."""

    @property
    def unit(self) -> str:
        """Return the unit of y and of the residual."""

    @property
    def drifts(self) -> bool:
        """Return whether the error is a random walk from the start of each recording."""

    @property
    def borrows(self) -> str | None:
        """Return the id of the scheme that determines the inertia of this scheme, or None; see `fit_equations`."""

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Compute equations y = phi theta, phi (N, P), for the columns of the terms; fixed columns are moved to y."""


# ------------------------------------------------------------------------------------- three views of a column


def compute_torque_view(m: Measurements, column: Column) -> Array:
    """Compute the torque at the instants per unit of the parameter, mass q'' + force + dry sgn q' (N,)."""
    x = m.samples
    torque = column.mass(x) * m.acceleration + m.compute_force(column) + column.dry(x) * np.sign(m.velocity)
    return np.broadcast_to(np.asarray(torque, dtype=float), m.time.shape)


def compute_impulse_view(m: Measurements, column: Column) -> Array:
    """Compute the mean torque over the sample before, (mass dq' + integral of force + dry sgn q') / period (N,)."""
    x = m.samples
    momentum = average_over_sample(column.mass(x), m) * compute_increments(m.velocity)
    force = m.compute_force(column) + column.dry(x) * np.sign(m.velocity)
    return momentum / m.period + average_over_sample(force, m)


def compute_energy_view(m: Measurements, column: Column) -> Array:
    """Compute the mean power over the sample before, (mass d(q'^2 / 2) + dU + dissipated work) / period (N,)."""
    x = m.samples
    stored = average_over_sample(column.mass(x), m) * compute_increments(0.5 * m.velocity**2)
    if column.potential is not None:
        stored = stored + compute_increments(column.potential(x) * np.ones(len(m)))
    power = column.power(x) + (m.compute_force(column) - column.force(x)) * m.velocity
    return stored / m.period + average_over_sample(power, m)


def compute_supply(m: Measurements) -> Array:
    """Compute the mean power of the filtered torque over the sample before each instant (N,) [W].

    Torque and velocity are linear within a sample: mean(tau v) = mean(tau) mean(v) + d tau dv / 12.
    """
    products = compute_increments(m.torque) * compute_increments(m.velocity)
    return m.held * compute_increments(m.position) / m.period + products / 12


def compute_increments(values: Array) -> Array:
    """Compute the increments up to each sample (N, ...); the first is 0."""
    return np.diff(values, axis=0, prepend=values[:1])


def average_over_sample(values: Array | float, m: Measurements) -> Array:
    """Average over the sample before each instant (N,), see `average_over_samples`."""
    return np.full(len(m), float(values)) if np.ndim(values) == 0 else average_over_samples(np.asarray(values))


def average_over_samples(f: Array) -> Array:
    """Average over samples before instants (N, ...): (-f[k-2] + 13 f[k-1] + 13 f[k] - f[k+1]) / 24.

    The first average is f[0]; the second and the last are of two values.
    """
    mean = np.empty_like(f)
    mean[2:-1] = (13 * (f[1:-2] + f[2:-1]) - (f[:-3] + f[3:])) / 24
    mean[[0, 1, -1]] = f[0], 0.5 * (f[0] + f[1]), 0.5 * (f[-2] + f[-1])
    return mean


VIEWS: dict[str, tuple[View, Callable[[Measurements], Array]]] = {  # of a column, and of the supply of the motor (N,)
    "torque": (compute_torque_view, lambda m: m.torque),
    "impulse": (compute_impulse_view, lambda m: m.held),
    "energy": (compute_energy_view, compute_supply),
}


def apply_low_pass(series: Array, cutoff: float, period: float, order: int = 1) -> Array:
    """Apply F = (lambda / (s + lambda))^order to mean values per sample, (N,) or (N, P), from rest.

    F[k] = a F[k-1] + (1 - a) x[k] with a = (2 - lambda T) / (2 + lambda T). This is the increment of the bilinear rule
    for the running sum of x.
    """
    a = compute_decay(cutoff, period)
    for _ in range(order):
        series = filter_lag(series, a)
    return series


def compute_decay(cutoff: float, period: float) -> float:
    """Compute the decay a of F over a sample, see `apply_low_pass`; a cutoff above Nyquist raises a `ValueError`."""
    if not 0 < cutoff < np.pi / period:
        unfiltered = [scheme.id for scheme in SCHEMES if not isinstance(scheme.operator, LowPass)]
        raise ValueError(
            f"a filter at {cutoff:g} rad/s needs samples at more than {cutoff / np.pi:.4g} Hz, these are at "
            f"{1 / period:.4g} Hz: sample faster, or leave out the filtered schemes: schemes={unfiltered}"
        )
    return (2 - cutoff * period) / (2 + cutoff * period)


# ------------------------------------------------------------------------------------------- operators on a balance


@dataclass(frozen=True)
class LowPass:
    """Low-pass filter F = (lambda / (s + lambda))^order on both sides of a balance, which needs no acceleration.

    Order 1 is the paper's F; with motion that is not smoothed, order 2 reduces the bias of the inertia by noise.
    """

    cutoff: float = CUTOFF  # lambda [rad/s]
    order: int = 1

    def __call__(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """Filter both sides of the balance times the gate (N,); equations within the gate are usable."""
        columns = np.column_stack([equations.phi, equations.y]) * gate[:, None]
        columns = apply_low_pass(columns, self.cutoff, period, self.order)
        return Regression(Equations(columns[:, :-1], columns[:, -1]), gate)


@dataclass(frozen=True)
class Integral:
    """Sum of both sides of a balance over a sliding `window` [s], or from the start of the recording if it is None.

    From the start, as in (7) of the paper, the error is a random walk, for which least squares is inefficient. Over a
    window, the error is nearly white.
    """

    window: float | None = 0.05

    def samples(self, period: float) -> int:
        """Return the length of the window [samples]; 0 sums from the start."""
        return 0 if self.window is None else max(1, round(self.window / period))

    def __call__(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """Sum both sides of the balance over the samples within the gate (N,), times the period [s].

        An equation is usable if the gate is open for half of the window, or without a window at the sample. The first
        window, or without a window the first sample, is not usable.
        """
        gate_times, length = gate * period, self.samples(period)
        phi, y = np.cumsum(equations.phi * gate_times[:, None], axis=0), np.cumsum(equations.y * gate_times)
        if length:
            phi[length:], y[length:] = phi[length:] - phi[:-length], y[length:] - y[:-length]
        n_open = np.cumsum(gate)
        n_open[length:] = n_open[length:] - n_open[:-length] if length else gate
        return Regression(Equations(phi, y), (np.arange(len(y)) >= max(1, length)) & (2 * n_open >= max(1, length)))


# -------------------------------------------------------------------------------------------------- six schemes


@dataclass(frozen=True)
class Scheme:
    """Regressor model: one view of the balance, away from stick, with a filter, an integral, or neither.

    Attributes:
        id: name in files and on the command line.
        balance: its equation.
        view: key of `VIEWS`.
        operator: filter or integral of both sides, or None.
        guard: distance to stick and reversals within which samples are left out [s], at least the reach of the
            smoothing. The gate stands before the filter, so that more than this reach only costs samples. None
            includes stick, as in the paper; the balance of energy leaves out rest, where no work is done.
        borrows: id of the scheme that determines the inertia, as in the paper's Hamiltonian pair; None estimates it.
    """

    id: str
    balance: str
    view: str
    operator: LowPass | Integral | None = None
    guard: float | None = 0.0
    borrows: str | None = None

    @property
    def unit(self) -> str:
        """Unit of y and of the residual."""
        return "N m" if self.view != "energy" else "J" if isinstance(self.operator, Integral) else "W"

    @property
    def adds_up(self) -> bool:
        """Return whether the balances of several joints are added."""
        return self.view == "energy"

    @property
    def drifts(self) -> bool:
        """Return whether the balance is summed from the start."""
        return isinstance(self.operator, Integral) and self.operator.window is None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Compute equations y = phi theta, phi (N, P); y is the supply minus fixed columns and known load."""
        m, (view, supplied) = add_states(m, terms), VIEWS[self.view]
        phi = np.column_stack([view(m, column) for term in terms for column in term.columns])
        fixed = [column for term in terms for column in term.fixed] + ([LOAD] if m.load else [])
        y = supplied(m) - sum(view(m, column) for column in fixed)
        return self.apply_operator(Equations(phi, y), self.gate(m.find_clear(self.guard), m.moving), m.period)

    def gate(self, clear: Mask, moving: Mask) -> Mask:
        """Find equations (N,) of the view without a sample in stick; means need the earlier sample, too."""
        if self.view == "torque":
            return clear
        is_open = clear & moving if self.view == "energy" else clear
        return is_open & np.append(False, is_open[:-1])

    def apply_operator(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """Apply the filter or integral to balances of the view (N,) within the gate."""
        return Regression(equations, gate) if self.operator is None else self.operator(equations, gate, period)


# E = I q'^2 / 2 + mgl (1 - cos q) is the stored energy, p = I q' the momentum. Balances of energy and power have a
# guard, because smoothing rounds |q'| at reversals and biases dry friction. If the inertia is estimated, the filtered
# Hamiltonian equals the filtered dynamic model.
SCHEMES: tuple[Scheme, ...] = (
    Scheme("dynamic", "tau = I q'' + mgl sin q + b q' + fc sgn q'", "torque"),
    Scheme("filtered_dynamic", "F tau = I lambda (1 - F) q' + F(mgl sin q + b q' + fc sgn q')", "impulse", LowPass()),
    Scheme("energy", "integral tau q' = E - E(0) + integral (b q'^2 + fc |q'|)", "energy", Integral()),
    Scheme("filtered_power", "F(tau q') = lambda (1 - F) E + F(b q'^2 + fc |q'|)", "energy", LowPass()),
    Scheme("hamiltonian", "tau = p' + mgl sin q + b p / I + fc sgn p", "impulse"),
    Scheme(
        "filtered_hamiltonian", "F tau = lambda (1 - F) p + F(mgl sin q + b p / I + fc sgn p)", "impulse", LowPass()
    ),
)


def scheme(id: str, **options: Any) -> Scheme:
    """Return a scheme by id with other options: `scheme("filtered_power", operator=LowPass(100.0))`.

    Raises:
        ValueError: if the id is unknown; the message lists the known ids.
    """
    return replace(find("scheme", id, {item.id: item for item in SCHEMES}), **options)


# The paper's choices: energy from the start with stick, its (7), and the Hamiltonian pair with borrowed inertia.
PAPER: tuple[Scheme, ...] = (
    *SCHEMES[:2],
    scheme("energy", operator=Integral(window=None), guard=None),
    scheme("filtered_power"),
    scheme("hamiltonian", borrows="dynamic"),
    scheme("filtered_hamiltonian", borrows="filtered_dynamic"),
)


def select_schemes(given: str | Sequence[str | Regressor]) -> tuple[Regressor, ...]:
    """Return schemes by object or id; "all" for the six.

    Raises:
        TypeError: if an object is no scheme.
        ValueError: if an id is unknown or used twice, or no scheme is given.
    """
    if isinstance(given, str) and given == "all":
        return SCHEMES
    chosen = tuple(scheme(item) if isinstance(item, str) else item for item in convert_to_tuple(given))
    for item in chosen:
        if isinstance(item, type) or not hasattr(item, "regression"):
            raise TypeError(
                f"{quote_value(item)} is not a scheme: give an id, such as 'energy', or scheme('energy', guard=0.02)"
            )
    ids = [item.id for item in chosen]
    if not ids:
        raise ValueError(f"there is no scheme to use: give ids of {', '.join(item.id for item in SCHEMES)}")
    if len(set(ids)) < len(ids):  # the result has one entry for each id
        raise ValueError(f"a scheme is named twice in {', '.join(ids)}: use each once")
    return chosen
