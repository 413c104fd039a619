"""Why the cares matter: what the true parameters leave of the balances of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.paper.ways import differentiated_backwards
from estimators.schemes.six import Integral, Scheme, scheme
from estimators.signals.measurements import measure
from pendulum_env._typing import Array
from pendulum_env.physics import BASE
from pendulum_env.recording import Recording


class Anatomy(NamedTuple):
    """What the true parameters leave of the balances of one run: why some samples and schemes tell less than others.

    Attributes:
        at_rest: share of samples in stick.
        torque_at_rest, torque_clear: RMS of the torque they leave there, and clear of stick and reversals [N m].
        acceleration: RMS by which the backward difference of the backward difference errs [rad/s^2].
        memory_from_start, memory_in_windows: correlation of the energy balance's error with itself a second later.
    """

    at_rest: float
    torque_at_rest: float
    torque_clear: float
    acceleration: float
    memory_from_start: float
    memory_in_windows: float


def dissect(recording: Recording, theta: Array) -> Anatomy:
    """Anatomy of a run with true parameters theta (4,)."""
    m = measure(recording)

    def left(scheme: Scheme) -> Array:
        equations, usable = scheme.regression(m, BASE)
        return (equations.y - equations.phi @ theta)[usable]

    def memory(scheme: Scheme) -> float:
        error, lag = left(scheme), round(1.0 / m.period)
        return float(np.corrcoef(error[:-lag], error[lag:])[0, 1])

    rest = ~m.moving
    return Anatomy(
        at_rest=float(np.mean(rest)),
        torque_at_rest=rms(left(scheme("dynamic", guard=None))[rest]),
        torque_clear=rms(left(scheme("dynamic"))),
        acceleration=rms(differentiated_backwards(recording).acceleration - m.acceleration),
        memory_from_start=memory(scheme("energy", operator=Integral(window=None))),
        memory_in_windows=memory(scheme("energy")),
    )


def rms(values: Array) -> float:
    """Root mean square, the paper's norm (10); NaN counts as not measured."""
    return float(np.sqrt(np.nanmean(values**2))) if len(values) else 0.0
