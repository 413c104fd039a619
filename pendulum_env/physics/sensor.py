"""Effects of the position sensor."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics.term import Column, NonlinearParameter, Samples, Term

Function = Callable[[Array], Array]


@dataclass(frozen=True)
class EncoderEccentricity(Term):
    """Encoder error of N periods in a turn: it reads q + e sin(Nq + phase), written as s sin Nq + c cos Nq.

    An eccentric disc has N = 1, a tilted or elliptic disc N = 2. The equation of motion holds for the true angle, which
    is q - s sin Nq - c cos Nq for the reading q. To first order in e, this adds, per unit of s,
    -(I d^2/dt^2 + mgl cos q + b d/dt) sin Nq, and per unit of c the same with cos Nq. Inertia, gravity and viscous
    friction equal those of the model.
    """

    inertia: float = 0.09
    gravity: float = 2.0
    viscous: float = 0.36
    order: float = 1.0

    id = "encoder_eccentricity"
    law = "-(I d^2/dt^2 + mgl cos q + b d/dt)(s sin Nq + c cos Nq) (usually N = 1)"
    kind = "sensor"
    is_decentralised = False
    is_revolute_only = True
    nonlinear_parameters = (
        NonlinearParameter("inertia", "kg m^2", 1e-9, 1e9, follows="inertia"),
        NonlinearParameter("gravity", "N m", -1e9, 1e9, follows="gravity"),
        NonlinearParameter("viscous", "N m s/rad", -1e9, 1e9, follows="viscous"),
        NonlinearParameter("order", "1", 1, 2, integer=True, nominal=1.0),
    )

    @property
    def columns(self) -> tuple[Column, ...]:
        n = self.order
        return (
            self._make_column("sin", lambda q: np.sin(n * q), lambda q: n * np.cos(n * q)),
            self._make_column("cos", lambda q: np.cos(n * q), lambda q: -n * np.sin(n * q)),
        )

    def _make_column(self, name: str, f: Function, slope: Function) -> Column:
        """Make the column -(I d^2/dt^2 + mgl cos q + b d/dt) f(q), with f'' = -N^2 f."""

        def force(x: Samples) -> Array:
            inertia, gravity = self._add_load(x)
            q, v = x.position, x.velocity
            return inertia * self.order**2 * f(q) * v**2 - gravity * np.cos(q) * f(q) - self.viscous * slope(q) * v

        return Column(
            f"encoder_eccentricity.{name}", "rad", mass=lambda x: -self._add_load(x)[0] * slope(x.position), force=force
        )

    def _add_load(self, x: Samples) -> tuple[ArrayLike, ArrayLike]:
        """Return inertia [kg m^2] and gravity [N m] including the known load."""
        return self.inertia + x.load.inertia, self.gravity + x.load.gravity
