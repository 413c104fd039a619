"""The paper's six regressions as it prints them, sample by sample: what `estimators.schemes.six` departs from.

For comparison only. Velocity is the backward difference of the encoder, the paper's "standard backwards difference
algorithm", and acceleration that of the velocity; torque is the command logged in the same row; every sample is used,
also those in stick, where sgn 0 = 0 stands for a friction that may be anything up to fc.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from estimators.regression.equations import Equations
from estimators.schemes.six import CUTOFF, Regression, Regressor, exponential_average
from estimators.signals.measurements import Measurements
from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.recording import Recording


def as_logged(recording: Recording) -> Measurements:
    """A recording row by row, differentiated backwards, its torque neither averaged nor delayed."""
    period = 1.0 / recording.rate
    velocity = backward_difference(recording.position, period)
    return Measurements(
        time=recording.time,
        position=recording.position,
        velocity=velocity,
        acceleration=backward_difference(velocity, period),
        torque=recording.torque,
        held=recording.torque,
        moving=velocity != 0,
        period=period,
        torque_noise=0.0,  # not known
        reach=2,
    )


def backward_difference(series: Array, period: float) -> Array:
    """(x[k] - x[k-1]) / T (N,), the first 0."""
    return np.diff(series, prepend=series[0]) / period


# ------------------------------------------------------------------------- four balances of torque, energy and power


def dynamic(m: Measurements, terms: Sequence[Term]) -> Equations:
    """Torque balance at the instants, tau = I q'' + mgl sin q + b q' + fc sgn q'."""
    return Equations(_columns(m, terms, lambda c, x: c.torque(x, m.acceleration)), m.torque)


def filtered_dynamic(m: Measurements, terms: Sequence[Term]) -> Equations:
    """Torque balance through F, F tau = I lambda (q' - F q') + F(mgl sin q + b q' + fc sgn q')."""
    momentum = _columns(m, terms, lambda c, x: c.mass(x) * x.velocity)
    rest = _columns(m, terms, lambda c, x: c.torque(x, 0.0))
    return Equations(CUTOFF * (momentum - low_pass(momentum, m)) + low_pass(rest, m), low_pass(m.torque, m))


def energy(m: Measurements, terms: Sequence[Term]) -> Equations:
    """Energy balance, integral tau q' = I (q'^2 - q'0^2) / 2 + mgl (cos q0 - cos q) + integral (b q'^2 + fc |q'|).

    Source: the paper's (7).
    """
    supplied = np.cumsum(m.torque * m.velocity) * m.period
    return Equations(_stored(m, terms) + np.cumsum(_dissipated(m, terms), axis=0) * m.period, supplied)


def filtered_power(m: Measurements, terms: Sequence[Term]) -> Equations:
    """Power balance through F, F(tau q') = lambda (1 - F) (I q'^2 / 2 + mgl (1 - cos q)) + F(b q'^2 + fc |q'|).

    Source: the paper's (8).
    """
    stored = _stored(m, terms)
    phi = CUTOFF * (stored - low_pass(stored, m)) + low_pass(_dissipated(m, terms), m)
    return Equations(phi, low_pass(m.torque * m.velocity, m))


def low_pass(series: Array, m: Measurements) -> Array:
    """F = lambda / (s + lambda) by the bilinear rule, from rest, over (N,) or (N, P)."""
    before = np.concatenate([np.zeros_like(series[:1]), series[:-1]])
    return exponential_average(0.5 * (before + series), CUTOFF, m.period)


def _columns(m: Measurements, terms: Sequence[Term], law: Callable[[Column, Samples], ArrayLike]) -> Array:
    columns = [column for term in terms for column in term.columns]
    return np.column_stack([np.broadcast_to(law(column, m.samples), m.time.shape) for column in columns])  # (N, P)


def _stored(m: Measurements, terms: Sequence[Term]) -> Array:
    """Stored energy since the first sample, per unit of each parameter (N, P)."""
    potential = _columns(m, terms, lambda c, x: 0.0 if c.potential is None else c.potential(x))
    stored = _columns(m, terms, lambda c, x: 0.5 * c.mass(x) * x.velocity**2) + potential
    return np.asarray(stored - stored[0])


def _dissipated(m: Measurements, terms: Sequence[Term]) -> Array:
    """Power that is lost, per unit of each parameter (N, P)."""
    return _columns(m, terms, lambda c, x: c.power(x))


# -------------------------------------------------------------------------------------------------- six schemes


@dataclass(frozen=True)
class Printed:
    """One of the paper's schemes over measurements `as_logged`; attributes as in `estimators.schemes.six.Regressor`."""

    id: str
    unit: str
    balance: Callable[[Measurements, Sequence[Term]], Equations]
    drifts: bool = False
    borrows: str | None = None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """The balance at every sample."""
        return Regression(self.balance(m, terms), np.ones(len(m), dtype=bool))


# The (9) with p = I q' and p' differenced backwards is the dynamic model, its inertia moved to the left-hand side.
PRINTED: tuple[Regressor, ...] = (
    Printed("dynamic", "N m", dynamic),
    Printed("filtered_dynamic", "N m", filtered_dynamic),
    Printed("energy", "J", energy, drifts=True),
    Printed("filtered_power", "W", filtered_power),
    Printed("hamiltonian", "N m", dynamic, borrows="dynamic"),
    Printed("filtered_hamiltonian", "N m", filtered_dynamic, borrows="filtered_dynamic"),
)
