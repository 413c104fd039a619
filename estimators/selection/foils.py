"""Laws without a name: any function of velocity, of angle, or of time, as torque, as friction or as motor gain.

No effect of the library is such a law, and none of them is ever proposed. They compete with the named effects by the
same score: where one of them surely predicts better, and explains most of what the named ones leave, they imitate it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Self

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Column, Samples, Shape, Term
from pendulum_env.physics.table import FrictionByAngle, FrictionBySpeed, GainBySpeed, Table, TorqueByAngle
from pendulum_env.words import name

PIECES = 12  # knots over velocity or angle
SLOW = 0.5  # [s], between knots over time


@dataclass(frozen=True)
class AnyFunction(Term):
    """Torque that is piecewise linear in one quantity between knots."""

    knots: tuple[float, ...] = ()

    axis: ClassVar[str] = ""
    words: ClassVar[str] = ""
    table: ClassVar[str | None] = None  # id of what keeps such a function
    law = "f(x)"

    def _hat(self, k: int, x: Samples) -> Array:
        """Hat function of one knot; the outermost go on as they end."""
        values = np.zeros(len(self.knots))
        values[k] = 1.0
        return np.interp(np.asarray(getattr(x, self.axis)), self.knots, values)

    @property
    def columns(self) -> tuple[Column, ...]:
        """One column a knot."""
        return tuple(Column(f"{self.id}.{k}", "N m", force=partial(self._hat, k)) for k in range(len(self.knots)))


def _quantiles(values: Array) -> tuple[float, ...]:
    """Knots with as much data between any two of them."""
    knots = np.unique(np.quantile(values, np.linspace(0.0, 1.0, PIECES)))
    return tuple(knots.tolist())


@dataclass(frozen=True)
class AnyOfVelocity(AnyFunction):
    """Friction that is any function of velocity, f(q')."""

    id = "any_function_of_velocity"
    axis = "velocity"
    words = "a function of velocity"
    table = FrictionBySpeed.id
    law = "f(q')"
    kind = "dissipative"

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Knots at quantiles of the speed, on either side."""
        half = _quantiles(np.abs(x.velocity))
        return [cls(tuple(sorted({*half, *(-knot for knot in half)})))]


@dataclass(frozen=True)
class AnyOfPosition(AnyFunction):
    """Torque that is any function of the angle, f(q)."""

    id = "any_function_of_position"
    axis = "position"
    words = "a function of the angle"
    table = TorqueByAngle.id
    law = "f(q)"
    kind = "potential"

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Knots at quantiles of the angle."""
        return [cls(_quantiles(np.asarray(x.position)))]


@dataclass(frozen=True)
class AnyFrictionOfPosition(AnyFunction):
    """Dry friction that is any function of the angle, f(q) sgn q'."""

    id = "any_friction_of_position"
    axis = "position"
    words = "dry friction that varies with the angle"
    table = FrictionByAngle.id
    law = "f(q) sgn q'"
    kind = "dissipative"

    @property
    def columns(self) -> tuple[Column, ...]:
        """One column a knot."""
        return tuple(Column(f"{self.id}.{k}", "N m", dry=partial(self._hat, k)) for k in range(len(self.knots)))

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Knots at quantiles of the angle."""
        return [cls(_quantiles(np.asarray(x.position)))]


@dataclass(frozen=True)
class AnyGain(AnyFunction):
    """Motor gain that is piecewise linear in one quantity between knots."""

    kind = "actuation"

    @property
    def one(self) -> float:
        """Knot at which the gain is one: what the torque is measured by."""
        return 0.0

    def _share(self, k: int, x: Samples) -> Array:
        return np.asarray(x.torque * self._hat(k, x))

    @property
    def columns(self) -> tuple[Column, ...]:
        """One column a knot but that one."""
        others = [k for k, knot in enumerate(self.knots) if knot != self.one]
        return tuple(Column(f"{self.id}.{k}", "1", force=partial(self._share, k), of_torque=True) for k in others)


@dataclass(frozen=True)
class AnyGainOfVelocity(AnyGain):
    """Motor gain that is any function of the speed, tau f(q')."""

    id = "any_gain_of_velocity"
    axis = "velocity"
    words = "a motor torque that varies with speed"
    table = GainBySpeed.id
    law = "tau f(q')"

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Knots at quantiles of the speed, on either side, and at rest."""
        half = _quantiles(np.abs(x.velocity))[1::2]
        return [cls(tuple(sorted({0.0, *half, *(-knot for knot in half)})))]


@dataclass(frozen=True)
class Wandering(AnyFunction):
    """Torque that wanders slowly with time, f(t)."""

    id = "any_function_of_time"
    axis = "time"
    words = "a torque that wanders with time"
    law = "f(t)"
    kind = "time-varying"

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Knots half a second apart."""
        first, last = float(np.min(x.time)), float(np.max(x.time))
        return [cls(tuple(np.linspace(first, last, max(3, round((last - first) / SLOW) + 1)).tolist()))]


@dataclass(frozen=True)
class WanderingGain(AnyGain):
    """Motor gain that wanders slowly with time, tau f(t)."""

    id = "any_gain_of_time"
    axis = "time"
    words = "a motor gain that wanders with time"
    law = "tau f(t)"

    @property
    def one(self) -> float:
        """The first knot."""
        return self.knots[0]

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Knots evenly apart: a motor warms and a battery empties slowly."""
        return [cls(tuple(np.linspace(float(np.min(x.time)), float(np.max(x.time)), PIECES // 2).tolist()))]


@dataclass(frozen=True)
class PowerLaw(Term):
    """Friction that grows with any power of the speed, c |q'|^p sgn q'."""

    power: float = 3.0

    table: ClassVar[str] = FrictionBySpeed.id

    id = "power_law"
    law = "c |q'|^p sgn q'"
    kind = "dissipative"
    shapes = (Shape("power", "1", 0.2, 9.0),)

    @property
    def columns(self) -> tuple[Column, ...]:
        """One column, per unit of c."""

        def force(x: Samples) -> Array:
            return np.asarray(np.sign(x.velocity) * np.abs(x.velocity) ** self.power)

        return (Column("power_law", "N m (s/rad)^p", force=force),)

    @classmethod
    def grid(cls, x: Samples, residual: Array) -> Iterable[Self]:
        """Powers from which a search starts."""
        return [cls(power) for power in (0.5, 1.5, 2.0, 3.0, 5.0)]


FOILS: Sequence[type[Term]] = (
    PowerLaw,
    AnyOfVelocity,
    AnyOfPosition,
    AnyFrictionOfPosition,
    AnyGainOfVelocity,
    Wandering,
    WanderingGain,
)


def wanders(term: Term) -> bool:
    """Whether it is a law of time."""
    return isinstance(term, AnyFunction) and term.axis == "time"


def words(foil: Term) -> str:
    """What a law without a name is."""
    if isinstance(foil, PowerLaw):
        return f"friction that grows as |q'|^{foil.power:.2g}"
    if isinstance(foil, Table):
        return f"{name(foil.id.partition('@')[0])}{f' at {foil.at}' if foil.at else ''}"
    assert isinstance(foil, AnyFunction)  # there are no others
    return foil.words
