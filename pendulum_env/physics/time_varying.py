"""Effects that change with time; time counts from the start of a recording."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.term import Column, Samples, Shape, Term


@dataclass(frozen=True)
class FrictionDrift(Term):
    """Friction that decays as the joint warms up: viscous and dry parts each have a share that fades with exp(-t/T)."""

    warm_up: float = 10.0

    id = "friction_drift"
    title = "friction that drifts with time"
    law = "(b1 q' + f1 sgn q') exp(-t/T)"
    kind = "time-varying"
    typical = "viscous=0.15,coulomb=0.35"
    omitted = "friction is that of a warm joint"
    reveal = "a recording from cold that lasts several warm-up times"
    symptom = "a change in time"
    signature = (
        "Friction falls from the beginning of the recording on, fast at first: errors at its start and of the "
        "other sign at its end."
    )
    resembles = ("payload_change",)
    shapes = (Shape("warm_up", "s", 0.01, 1e6),)

    @property
    def columns(self) -> tuple[Column, ...]:
        warm_up = self.warm_up
        return (
            Column("friction_drift.viscous", "N m s/rad", force=lambda x: x.velocity * np.exp(-x.time / warm_up)),
            Column("friction_drift.coulomb", "N m", dry=lambda x: np.exp(-x.time / warm_up) * np.ones_like(x.velocity)),
        )

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        span = float(np.max(x.time))
        return [cls(float(warm_up)) for warm_up in np.geomspace(span / 20, span * 1.5, 8)]


@dataclass(frozen=True)
class PayloadChange(Term):
    """Inertia and gravity that jump at an unknown time, the speed being continuous: a payload picked up or lost."""

    moment: float = 10.0

    id = "payload_change"
    title = "a payload change"
    law = "(dI q'' + dmgl sin q) for t > t0"
    kind = "time-varying"
    typical = "gravity=0.4"
    omitted = "the payload is that before the change"
    reveal = "a recording that spans the change"
    symptom = "a change in time"
    signature = (
        "From one moment on the arm is heavier or lighter: errors like those of a wrong weight and inertia begin, "
        "or end, within one sample."
    )
    resembles = ("friction_drift",)
    shapes = (Shape("moment", "s", 0.0, 1e6, instant=True),)

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column("payload_change.inertia", "kg m^2", mass=lambda x: self._after(x) * np.ones_like(x.velocity)),
            Column("payload_change.gravity", "N m", force=lambda x: self._after(x) * np.sin(x.position)),
        )

    def _after(self, x: Samples) -> Array:
        return np.where(x.time >= self.moment, 1.0, 0.0)

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        start, stop = float(np.min(x.time)), float(np.max(x.time))
        return [cls(float(moment)) for moment in start + (stop - start) * np.arange(0.04, 0.97, 0.02)]


@dataclass(frozen=True)
class PeriodicDisturbance(Term):
    """External torque that is periodic in time, s sin wt + c cos wt, of unknown frequency w."""

    frequency: float = 10.0

    id = "periodic_disturbance"
    title = "a periodic disturbance"
    law = "s sin wt + c cos wt"
    kind = "time-varying"
    reveal = "a recording of many periods"
    symptom = "a change in time"
    signature = (
        "What is left is a sine of time, whatever the joint does: one sharp peak in its spectrum, also while the "
        "joint stands."
    )
    resembles = ("cogging",)
    shapes = (Shape("frequency", "rad/s", 1e-5, 1e5),)
    peaks = 8  # of a periodogram, the highest ones, from which a search starts

    @property
    def columns(self) -> tuple[Column, ...]:
        w = self.frequency
        return (
            Column("periodic_disturbance.sin", "N m", force=lambda x: np.sin(w * x.time) * np.ones_like(x.velocity)),
            Column("periodic_disturbance.cos", "N m", force=lambda x: np.cos(w * x.time) * np.ones_like(x.velocity)),
        )

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        omega, power = cls._periodogram(x, residual)
        peaks = np.flatnonzero((power[1:-1] >= power[2:]) & (power[1:-1] >= power[:-2])) + 1
        highest = peaks[np.argsort(power[peaks])[::-1][: cls.peaks]]
        return [cls(float(w)) for w in omega[highest]]

    @classmethod
    def looked_at(cls, x: Samples, residual: Array) -> int:
        return len(cls._periodogram(x, residual)[0])

    @staticmethod
    def _periodogram(x: Samples, residual: Array) -> tuple[Array, Array]:
        """Frequencies [rad/s], so close that no peak falls between two of them, and the residual's power there."""
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
