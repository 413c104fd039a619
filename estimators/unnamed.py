"""Laws that the library does not name: where one of them does the work of named ones, these are not what is there.

Quadratic drag and Stribeck friction together follow nearly any damping that grows with the speed. A single power of the
speed that fits as well as both, with fewer parameters, says that neither is there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Column, Samples, Shape, Term

IMITATED = "quadratic_drag"  # the effect that stands for damping that grows with the speed,
IMITATORS = (IMITATED, "stribeck")  # and those that together follow many a curve over speed
NEAR = 0.3  # from the power of a named law, within which it is that law


@dataclass(frozen=True)
class PowerLaw(Term):
    """Damping that grows with any power of the speed, c |q'|^p sgn q'."""

    power: float = 3.0

    id = "power_law"
    law = "c |q'|^p sgn q'"
    kind = "dissipative"
    shapes = (Shape("power", "1", 0.2, 9.0),)

    @property
    def columns(self) -> tuple[Column, ...]:
        """One column, per unit of c."""
        return (
            Column(
                "power_law",
                "N m (s/rad)^p",
                force=lambda x: np.sign(x.velocity) * np.abs(x.velocity) ** self.power,
            ),
        )

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Powers from which a search starts."""
        return [cls(power) for power in (0.5, 1.5, 2.0, 3.0, 5.0)]

    @property
    def is_named(self) -> bool:
        """Whether it is as good as Coulomb friction, viscous friction or quadratic drag."""
        return min(abs(self.power - power) for power in (0.0, 1.0, 2.0)) < NEAR

    @property
    def words(self) -> str:
        """The law with its power."""
        return f"friction that grows as |q'|^{self.power:.2g}"
