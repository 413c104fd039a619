"""Six regressor models of one pendulum: each turns measurements and terms into a linear regression, and stops there.

Three views of the torque balance tau = sum_k theta_k (mass_k q'' + force_k + dry_k sgn q') are enough for all six:

    torque   at an instant                                  dynamic
    impulse  mean torque over a sample, from momentum       hamiltonian, filtered_dynamic, filtered_hamiltonian
    energy   mean power over a sample, from stored energy   energy, filtered_power

Momentum and stored energy enter by their increments, so a mass that jumps at some time does so without doing work, and
a gate can leave out stick: the balance times any gate is still a balance. F = lambda / (s + lambda) then acts on the
gated balance, both sides alike, starts from rest with it and needs no warm-up, at the start or after stick.

With the bilinear rule for F, lambda (1 - F) of a running sum is exactly the exponential average of its increments:
lambda (1 - F) p = F p' without differentiating p. That is how the filtered schemes are computed.

Departures from the paper: samples in stick are left out (there dry friction is any torque up to fc, not fc sgn q');
eq. (9) lacks a factor 1/2 and the grouping of its derivative; its Hamiltonian pair borrows the inertia of the dynamic
pair, here that is an option (`PAPER`), as momentum is linear in the parameters too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from estimators.regression.equations import Equations
from estimators.signals.measurements import Measurements, remember
from pendulum_env._typing import Array, Mask
from pendulum_env.filters import lag
from pendulum_env.lookup import find
from pendulum_env.physics import Column, Term
from pendulum_env.physics.term import LOAD

CUTOFF = 200.0  # lambda [rad/s], the paper's 31.83 Hz
GUARD = 0.02  # [s] on either side of stick and reversals

View = Callable[[Measurements, Column], Array]


class Regression(NamedTuple):
    """Equations, one for each of N samples, and those that may be used (N,)."""

    equations: Equations
    usable: Mask


class Scheme(Protocol):
    """What a scheme offers."""

    @property
    def id(self) -> str:
        """Name in files and on the command line."""

    @property
    def unit(self) -> str:
        """Unit of y and of the residual."""

    @property
    def drifts(self) -> bool:
        """Whether the error is a random walk from the start of each recording, where it otherwise forgets."""

    @property
    def borrows(self) -> str | None:
        """Id of the scheme that finds the inertia this one is given, if any; see `give`."""

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations y = phi theta, phi (N, P), for the columns of the terms in order; fixed columns are moved to y."""


class OnlineScheme(Scheme, Protocol):
    """A scheme that says how it works sample by sample; a filter says its `cutoff` and `order`, a sum its `window`."""

    @property
    def view(self) -> str:
        """Which of the three views it takes of a column."""

    @property
    def guard(self) -> float | None:
        """Distance to stick and reversals [s]."""

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """What becomes of balances on its view (N,), true within the gate: as they are, behind F, or summed."""


# ------------------------------------------------------------------------------------- three views of a column


def torque_view(m: Measurements, column: Column) -> Array:
    """Torque at the instants per unit of the parameter, mass q'' + force + dry sgn q' (N,)."""
    return np.broadcast_to(np.asarray(column.torque(m.samples, m.acceleration), dtype=float), m.time.shape)


def impulse_view(m: Measurements, column: Column) -> Array:
    """Mean torque over the sample before each instant, (mass dq' + integral of force + dry sgn q') / period (N,)."""
    x = m.samples
    momentum = mean_over_sample(column.mass(x), m) * increments(m.velocity)
    return momentum / m.period + mean_over_sample(column.force(x) + column.dry(x) * np.sign(m.velocity), m)


def energy_view(m: Measurements, column: Column) -> Array:
    """Mean power over the sample before each instant, (mass d(q'^2 / 2) + dU + dissipated work) / period (N,)."""
    x = m.samples
    stored = mean_over_sample(column.mass(x), m) * increments(0.5 * m.velocity**2)
    if column.potential is not None:
        stored = stored + increments(column.potential(x) * np.ones(len(m)))
    return stored / m.period + mean_over_sample(column.power(x), m)


def supply(m: Measurements) -> Array:
    """Mean power of the held torque over the sample before each instant (N,) [W]."""
    return m.held * increments(m.position) / m.period


def increments(values: Array) -> Array:
    """Increments up to each sample (N, ...), the first 0."""
    return np.diff(values, axis=0, prepend=values[:1])


def mean_over_sample(values: Array | float, m: Measurements) -> Array:
    """Mean over the sample before each instant (N,), see `means`."""
    return np.full(len(m), float(values)) if np.ndim(values) == 0 else means(np.asarray(values))


def means(f: Array) -> Array:
    """Means over samples before instants (N, ...), of fourth order: (-f[k-2] + 13 f[k-1] + 13 f[k] - f[k+1]) / 24."""
    mean = np.empty_like(f)
    mean[2:-1] = (13 * (f[1:-2] + f[2:-1]) - (f[:-3] + f[3:])) / 24
    mean[[0, 1, -1]] = f[0], 0.5 * (f[0] + f[1]), 0.5 * (f[-2] + f[-1])
    return mean


def _assemble(m: Measurements, terms: Sequence[Term], view: View, supplied: Array) -> Equations:
    """Regression of what is supplied (N,), less fixed columns and known load, on one view of the linear columns."""
    m = remember(m, terms)
    phi = np.column_stack([view(m, column) for term in terms for column in term.columns])  # (N, P)
    fixed = [column for term in terms for column in term.fixed] + ([LOAD] if m.load else [])
    return Equations(phi, supplied - sum(view(m, column) for column in fixed))


def give(equations: Equations, columns: Sequence[int], theta: Array) -> Equations:
    """Move columns whose parameters theta (G,) are known from phi (N, P) to y."""
    known = list(columns)
    return Equations(np.delete(equations.phi, known, axis=1), equations.y - equations.phi[:, known] @ theta)


def exponential_average(series: Array, cutoff: float, period: float, order: int = 1) -> Array:
    """F = (lambda / (s + lambda))^order over mean values per sample, (N,) or (N, P), from rest.

    F[k] = a F[k-1] + (1 - a) x[k] with a = (2 - lambda T) / (2 + lambda T): the bilinear rule, applied to the running
    sum of x and differentiated.

    Raises:
        ValueError: if lambda is beyond the Nyquist frequency.
    """
    a = forgets(cutoff, period)
    for _ in range(order):
        series = lag(series, a)
    return series


def forgets(cutoff: float, period: float) -> float:
    """Share a of F that is left after a sample.

    Raises:
        ValueError: if lambda is beyond the Nyquist frequency.
    """
    if not 0 < cutoff < np.pi / period:
        raise ValueError(
            f"a filter at {cutoff:g} rad/s needs samples at more than {cutoff / np.pi:.4g} Hz, these are at "
            f"{1 / period:.4g} Hz: lower the cutoff or sample faster"
        )
    return (2 - cutoff * period) / (2 + cutoff * period)


def _filtered(equations: Equations, gate: Mask, cutoff: float, order: int, period: float) -> Regression:
    """The gated balance behind F on both sides."""
    both = np.column_stack([equations.phi, equations.y]) * gate[:, None]
    both = exponential_average(both, cutoff, period, order)
    return Regression(Equations(both[:, :-1], both[:, -1]), gate)


def over_samples(clear: Mask) -> Mask:
    """Steps whose both ends are clear (N,); the first has no beginning."""
    gate = np.zeros_like(clear)
    gate[1:] = clear[1:] & clear[:-1]
    return gate


# -------------------------------------------------------------------------------------------------- six schemes


@dataclass(frozen=True)
class Dynamic:
    """Torque balance at the instants, tau = I q'' + mgl sin q + b q' + fc sgn q'; needs the acceleration.

    guard: distance to stick and reversals [s]; None keeps even stick, as the paper does.
    """

    guard: float | None = GUARD
    id: ClassVar[str] = "dynamic"
    view: ClassVar[str] = "torque"
    unit: ClassVar[str] = "N m"
    drifts: ClassVar[bool] = False
    borrows: ClassVar[str | None] = None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations with y = tau [N m]."""
        return self.through(_assemble(m, terms, torque_view, m.torque), m.clear(self.guard), m.period)

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """The balance as it is."""
        return Regression(equations, gate)


@dataclass(frozen=True)
class FilteredDynamic:
    """Torque balance through F on both sides, F tau = I lambda (1 - F) q' + F(mgl sin q + b q' + fc sgn q').

    Needs no acceleration. order 1 is the paper's F, 2 is F^2: where the motion is not smoothed, it keeps encoder noise
    out of the inertia.
    """

    cutoff: float = CUTOFF  # [rad/s]
    order: int = 1
    guard: float | None = GUARD  # [s]
    id: ClassVar[str] = "filtered_dynamic"
    view: ClassVar[str] = "impulse"
    unit: ClassVar[str] = "N m"
    drifts: ClassVar[bool] = False
    borrows: ClassVar[str | None] = None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations with y = F tau [N m]."""
        return self.through(_assemble(m, terms, impulse_view, m.held), over_samples(m.clear(self.guard)), m.period)

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """The balance behind F."""
        return _filtered(equations, gate, self.cutoff, self.order, period)


@dataclass(frozen=True)
class Energy:
    """Energy balance, integral tau q' = I (q'^2 - q'0^2) / 2 + mgl (cos q0 - cos q) + integral (b q'^2 + fc |q'|).

    Needs no stick mask: no motion, no work. From the start of the recording on, as in the paper's (7), its error is a
    random walk and least squares is far from efficient; over a sliding `window`, it is nearly white.

    window: length over which the balance is taken [s]; None takes it from the start.
    guard: distance to stick and reversals within which no work is counted [s]; None counts all.
    """

    window: float | None = 0.05
    guard: float | None = None
    id: ClassVar[str] = "energy"
    view: ClassVar[str] = "energy"
    unit: ClassVar[str] = "J"
    borrows: ClassVar[str | None] = None

    @property
    def drifts(self) -> bool:
        """Whether the balance is taken from the start."""
        return self.window is None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations with y = work of the torque [J], the held torque times the way it acts over."""
        power = _assemble(m, terms, energy_view, supply(m))
        return self.through(power, over_samples(m.clear(self.guard)), m.period)

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """The power balance, summed over the window or from the start."""
        moments = gate * period
        phi, y = np.cumsum(equations.phi * moments[:, None], axis=0), np.cumsum(equations.y * moments)
        n = 0 if self.window is None else max(1, round(self.window / period))
        if n:
            phi[n:], y[n:] = phi[n:] - phi[:-n], y[n:] - y[:-n]
        return Regression(Equations(phi, y), np.arange(len(y)) >= max(1, n))


@dataclass(frozen=True)
class FilteredPower:
    """Power balance through F on both sides, F(tau q') = lambda (1 - F) E + F(b q'^2 + fc |q'|), E the stored energy.

    Needs no acceleration, nor strictly a stick mask: no motion, no power. But where a coarse encoder asks for long
    smoothing, |q'| is rounded at reversals, so they are left out all the same. Source: the paper's (8).
    """

    cutoff: float = CUTOFF  # [rad/s]
    order: int = 1
    guard: float | None = GUARD  # [s]
    id: ClassVar[str] = "filtered_power"
    view: ClassVar[str] = "energy"
    unit: ClassVar[str] = "W"
    drifts: ClassVar[bool] = False
    borrows: ClassVar[str | None] = None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations with y = F(tau q') [W]."""
        return self.through(_assemble(m, terms, energy_view, supply(m)), over_samples(m.clear(self.guard)), m.period)

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """The power balance behind F."""
        return _filtered(equations, gate, self.cutoff, self.order, period)


@dataclass(frozen=True)
class Hamiltonian:
    """Hamilton's p' = tau - dH/dq - f, tau = p' + mgl sin q + b q' + fc sgn q', with p' from steps of the momentum.

    Momentum p = (d phi_k / d q')' theta_k is linear in the parameters, so inertia is estimated with the others; with
    `borrows` naming a scheme, `identify` gives its inertia instead and p = I q' stands beside tau, as in the paper's
    (9). The other parameters then equal those of that scheme.
    """

    borrows: str | None = None
    guard: float | None = GUARD  # [s]
    id: ClassVar[str] = "hamiltonian"
    view: ClassVar[str] = "impulse"
    unit: ClassVar[str] = "N m"
    drifts: ClassVar[bool] = False

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations with y = tau [N m]."""
        return self.through(_assemble(m, terms, impulse_view, m.held), over_samples(m.clear(self.guard)), m.period)

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """The balance as it is."""
        return Regression(equations, gate)


@dataclass(frozen=True)
class FilteredHamiltonian:
    """Hamilton's equation through F, F tau = lambda (1 - F) p + F(mgl sin q + b p / I + fc sgn p).

    With the inertia estimated too, it is the filtered dynamic model in other words; see `Hamiltonian` for `borrows`.
    """

    cutoff: float = CUTOFF  # [rad/s]
    order: int = 1
    borrows: str | None = None
    guard: float | None = GUARD  # [s]
    id: ClassVar[str] = "filtered_hamiltonian"
    view: ClassVar[str] = "impulse"
    unit: ClassVar[str] = "N m"
    drifts: ClassVar[bool] = False

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """Equations with y = F tau [N m]."""
        return self.through(_assemble(m, terms, impulse_view, m.held), over_samples(m.clear(self.guard)), m.period)

    def through(self, equations: Equations, gate: Mask, period: float) -> Regression:
        """The balance behind F."""
        return _filtered(equations, gate, self.cutoff, self.order, period)


SCHEMES: tuple[OnlineScheme, ...] = (
    Dynamic(),
    FilteredDynamic(),
    Energy(),
    FilteredPower(),
    Hamiltonian(),
    FilteredHamiltonian(),
)
# The paper's choices: energy from the start, and the Hamiltonian pair with borrowed inertia.
PAPER: tuple[Scheme, ...] = (
    Dynamic(),
    FilteredDynamic(),
    Energy(window=None),
    FilteredPower(),
    Hamiltonian(borrows="dynamic"),
    FilteredHamiltonian(borrows="filtered_dynamic"),
)


def scheme(id: str) -> OnlineScheme:
    """Scheme of that id, with its default options.

    Raises:
        ValueError: if there is none; the message names the nearest and all that exist.
    """
    return find("scheme", id, {item.id: item for item in SCHEMES})
