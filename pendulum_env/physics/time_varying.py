"""Effects that change with the time since the start of a recording."""

from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics.term import Column, NonlinearParameter, Samples, Term


@dataclass(frozen=True)
class FrictionDrift(Term):
    """Friction that decays as the joint warms up: viscous and dry parts each have a share that fades with exp(-t/T)."""

    warm_up: float = 10.0

    id = "friction_drift"
    law = "(b1 q' + f1 sgn q') exp(-t/T)"
    kind = "time-varying"
    nonlinear_parameters = (NonlinearParameter("warm_up", "s", 0.01, 1e6),)
    typical_size = "viscous=0.15,coulomb=0.35"

    @property
    def columns(self) -> tuple[Column, ...]:
        warm_up = self.warm_up
        return (
            Column("friction_drift.viscous", "N m s/rad", force=lambda x: x.velocity * np.exp(-x.time / warm_up)),
            Column("friction_drift.coulomb", "N m", dry=lambda x: np.exp(-x.time / warm_up) * np.ones_like(x.velocity)),
        )


@dataclass(frozen=True)
class PayloadChange(Term):
    """Inertia and gravity that jump at an unknown time, the speed being continuous: a payload picked up or lost."""

    moment: float = 10.0

    id = "payload_change"
    law = "(dI q'' + dmgl sin q) for t > t0"
    kind = "time-varying"
    is_decentralised = False
    nonlinear_parameters = (NonlinearParameter("moment", "s", 0.0, 1e6, instant=True),)
    typical_size = "gravity=0.4"

    @property
    def columns(self) -> tuple[Column, ...]:
        return (
            Column("payload_change.inertia", "kg m^2", mass=lambda x: self._has_changed(x) * np.ones_like(x.velocity)),
            Column("payload_change.gravity", "N m", force=lambda x: self._has_changed(x) * np.sin(x.position)),
        )

    def _has_changed(self, x: Samples) -> Array:
        """Return 1 after the change, else 0."""
        return np.where(x.time >= self.moment, 1.0, 0.0)


@dataclass(frozen=True)
class PeriodicDisturbance(Term):
    """External torque that is periodic in time, s sin wt + c cos wt, of unknown frequency w."""

    frequency: float = 10.0

    id = "periodic_disturbance"
    law = "s sin wt + c cos wt"
    kind = "time-varying"
    nonlinear_parameters = (NonlinearParameter("frequency", "rad/s", 1e-5, 1e5, is_frequency=True),)

    @property
    def columns(self) -> tuple[Column, ...]:
        w = self.frequency
        return (
            Column("periodic_disturbance.sin", "N m", force=lambda x: np.sin(w * x.time) * np.ones_like(x.velocity)),
            Column("periodic_disturbance.cos", "N m", force=lambda x: np.cos(w * x.time) * np.ones_like(x.velocity)),
        )
