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


def low_pass(series: Array, m: Measurements) -> Array:
    """F = lambda / (s + lambda) by the bilinear rule, from rest, over (N,) or (N, P)."""
    before = np.concatenate([np.zeros_like(series[:1]), series[:-1]])
    return exponential_average(0.5 * (before + series), CUTOFF, m.period)


@dataclass(frozen=True)
class Printed:
    """One of the paper's schemes over measurements `as_logged`; attributes as in `estimators.schemes.six.Regressor`.

    The balances, with momentum p = I q' and energy E = I q'^2 / 2 + mgl (1 - cos q):

        dynamic           tau = I q'' + mgl sin q + b q' + fc sgn q'
        filtered_dynamic  F tau = lambda (1 - F) p + F(mgl sin q + b q' + fc sgn q')
        energy            integral tau q' = E - E(0) + integral (b q'^2 + fc |q'|), the paper's (7)
        filtered_power    F(tau q') = lambda (1 - F) E + F(b q'^2 + fc |q'|), the paper's (8)

    The (9) with p' differenced backwards is the dynamic model, its inertia moved to the left-hand side.
    """

    id: str
    unit: str
    drifts: bool = False
    borrows: str | None = None

    def regression(self, m: Measurements, terms: Sequence[Term]) -> Regression:
        """The balance at every sample."""

        def columns(law: Callable[[Column, Samples], ArrayLike]) -> Array:
            each = [law(column, m.samples) for term in terms for column in term.columns]
            return np.column_stack([np.broadcast_to(values, m.time.shape) for values in each])  # (N, P)

        if self.unit == "N m":
            stored = columns(lambda c, x: c.mass(x) * x.velocity)
            rest, supplied = columns(lambda c, x: c.torque(x, 0.0)), m.torque
        else:
            stored = columns(lambda c, x: 0.5 * c.mass(x) * x.velocity**2 + (c.potential(x) if c.potential else 0.0))
            stored -= stored[0]
            rest, supplied = columns(lambda c, x: c.power(x)), m.torque * m.velocity
        if "filtered" in self.id:
            phi, y = CUTOFF * (stored - low_pass(stored, m)) + low_pass(rest, m), low_pass(supplied, m)
        elif self.drifts:
            phi, y = stored + np.cumsum(rest, axis=0) * m.period, np.cumsum(supplied) * m.period
        else:
            phi, y = columns(lambda c, x: c.torque(x, m.acceleration)), supplied
        return Regression(Equations(phi, y), np.ones(len(m), dtype=bool))


PRINTED: tuple[Regressor, ...] = (
    Printed("dynamic", "N m"),
    Printed("filtered_dynamic", "N m"),
    Printed("energy", "J", drifts=True),
    Printed("filtered_power", "W"),
    Printed("hamiltonian", "N m", borrows="dynamic"),
    Printed("filtered_hamiltonian", "N m", borrows="filtered_dynamic"),
)
