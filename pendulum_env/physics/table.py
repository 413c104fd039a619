"""Tables: nonparametric functions of angle, speed or time by cubic B-splines.

A table is a term that is fitted, confirmed on held-out data, simulated and exported, but not proposed as a cause. It
competes with the effects by the same score. If a table predicts significantly better and explains most of the effects'
residual, the effects are imitations. A table is orthogonal to functions that the model contains, such as gravity, an
offset or Coulomb friction. It has zero curvature at its ends and is constant beyond them. A function of time differs
between recordings, so models do not keep it.

Source: de Boor, A Practical Guide to Splines, 2001.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated, Any, ClassVar, NamedTuple, Self, cast

import numpy as np
import scipy
from msgspec import Meta, Struct
from msgspec.structs import astuple, replace

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.errors import FileError, UserError
from pendulum_env.physics.term import Column, NonlinearParameter, Samples, Term, derive_kind
from pendulum_env.reading import Number, Text, convert

FARTHEST, NARROWEST = 1e6, 1e-6  # [rad, rad/s], largest end and least relative width of a table in a file
OF_ANGLE: dict[str, Callable[[Array], Array]] = {
    "one": np.ones_like,
    "line": np.positive,
    "sine": np.sin,
    "cosine": np.cos,
}


class Extent(Struct, frozen=True):
    """Range of a table [rad, rad/s or s] and number of equal pieces; the range -pi to pi is periodic.

    `beside` names the angle functions of other terms; a torque by angle is orthogonal to them. `merged` are the knots,
    counted from the low end, whose two pieces are one: few data lie there.
    """

    low: Number
    high: Number
    pieces: Annotated[int, Meta(ge=3, le=100)]
    beside: tuple[Text, ...] = ()
    merged: tuple[Annotated[int, Meta(ge=1, le=99)], ...] = ()

    @property
    def is_periodic(self) -> bool:
        """Return whether the table is periodic over a turn."""
        return self.low == -np.pi and self.high == np.pi


def read_table(kind: type[Table], data: Any, key: str) -> Table:
    """Make a table from the extent under a key of a model file."""
    extent = convert(data, Extent, key)
    least = 0.0 if kind.axis == "velocity" else -FARTHEST
    is_wide = extent.high - extent.low > NARROWEST * max(1.0, abs(extent.low))
    if not (least <= extent.low and extent.high <= FARTHEST and is_wide):
        raise FileError(f"'{key}' has to reach from low to high, within {least:g} and {FARTHEST:g}")
    n_left = len(set(range(extent.pieces)) - set(extent.merged))
    if n_left != extent.pieces - len(extent.merged) or n_left < 3:
        raise FileError(f"'{key}.merged' has to list knots below {extent.pieces}, each once, and leave three pieces")
    if not set(extent.beside) <= OF_ANGLE.keys() or n_left <= len(extent.beside):
        raise FileError(f"'{key}' has to leave some of {', '.join(OF_ANGLE)} to others, fewer than it has pieces")
    return kind.with_extent(extent)()


class TableCurve(NamedTuple):
    """Table as a function: arguments, values and standard errors, (N,) each."""

    x: Array
    value: Array
    std: Array


@dataclass(frozen=True)
class Table(Term):
    """Function of one quantity with linear parameters; the extent belongs to the class, see `with_extent`."""

    is_free_form = True
    extent: ClassVar[Extent] = Extent(-1.0, 1.0, 4)
    axis: ClassVar[str] = ""
    unit: ClassVar[str] = "N m"
    is_dry: ClassVar[bool] = False  # whether the torque is set-valued friction
    is_gain: ClassVar[bool] = False  # whether the table is a share of the commanded torque, zero at its low end

    @classmethod
    def with_extent(cls, extent: Extent) -> type[Self]:
        """Return the class of the table with another extent."""
        return cast(type[Self], _set_extent(cls.__dict__.get("bare_table", cls), extent))

    def without_known_functions(self, terms: Sequence[Term]) -> Table:
        """Return the table orthogonal to the functions of its argument that the terms contain."""
        return self

    def covers(self, x: Samples) -> bool:
        """Return whether the extent covers samples (N,), so that the table predicts their torque."""
        return True

    @classmethod
    def argument(cls, x: Samples) -> ArrayLike:
        """Return the argument of the function."""
        raise NotImplementedError

    @classmethod
    def laws(cls) -> Sequence[Callable[[Array], Array]]:
        """Return the functions of the argument to which the table is orthogonal."""
        return ()

    @classmethod
    def column(cls, name: str, law: Callable[[Samples], ArrayLike]) -> Column:
        """Make the column of one coefficient."""
        if cls.is_gain:
            return Column(name, cls.unit, force=lambda x: x.torque * law(x), of_torque=True)
        return Column(name, cls.unit, dry=law) if cls.is_dry else Column(name, cls.unit, force=law)

    @classmethod
    def warp(cls, argument: ArrayLike) -> ArrayLike:
        """Map the argument to the scale with equidistant knots."""
        return argument

    @property
    def columns(self) -> tuple[Column, ...]:
        return _make_columns(type(self))  # type: ignore[arg-type]  # classes are hashable

    @classmethod
    def basis(cls, argument: ArrayLike) -> list[ArrayLike]:
        """Return the basis functions of the coefficients at an argument."""
        return [_sum_splines(cls, argument, row) for row in _compute_weights(cls)]  # type: ignore[arg-type]

    def curve(self, theta: Array, covariance: Array | None = None) -> TableCurve:
        """Evaluate the function for linear parameters (P,), with standard errors from their covariance (P, P)."""
        x = np.linspace(self.extent.low, self.extent.high, 241)
        phi = np.column_stack([np.broadcast_to(column, x.shape) for column in self.basis(x)])
        variance = np.zeros(len(x)) if covariance is None else np.einsum("np,pq,nq->n", phi, covariance, phi)
        return TableCurve(x, phi @ theta, np.sqrt(np.maximum(variance, 0.0)))


def _sum_splines(kind: type[Table], argument: ArrayLike, weights: Mapping[int, float]) -> ArrayLike:
    """Sum cubic B-splines at an argument; `weights` are keyed by the index of the spline's central knot."""
    low, high, pieces, *_ = astuple(kind.extent)
    if kind.extent.is_periodic:
        inside: Any = 2.0 * np.arctan(np.tan(0.5 * argument))
    else:
        low, high = (float(cast(float, kind.warp(end))) for end in (low, high))
        inside = np.clip(kind.warp(argument), low, high)
    place = (inside - low) * (pieces / (high - low))  # in pieces from the low end
    total: ArrayLike = 0
    for knot, weight in weights.items():
        distance = np.absolute(place - float(knot))
        spline = _evaluate_spline(distance)
        total = total + weight * (spline + _evaluate_spline(pieces - distance) if kind.extent.is_periodic else spline)
    return total


def _evaluate_spline(distance: Any) -> Any:
    """Evaluate the cubic B-spline at a distance of `distance` knots from its centre."""
    near, far = np.maximum(1.0 - distance, 0.0), np.maximum(2.0 - distance, 0.0)
    return (far * far * far - 4.0 * (near * near * near)) / 6.0


@cache
def _set_extent(kind: type[Table], extent: Extent) -> type[Table]:
    return derive_kind(kind, _set_extent, extent, extent=extent, bare_table=kind)


@cache
def _compute_weights(kind: type[Table]) -> tuple[dict[int, float], ...]:
    """Compute the spline weights of each coefficient of a table, subject to orthogonality and end conditions."""
    low, high, pieces, *_ = astuple(kind.extent)
    knots = range(pieces) if kind.extent.is_periodic else range(-1, pieces + 2)
    fine = 2000  # points of the inner product
    x = low + (high - low) * (np.arange(fine) + 0.5) / fine

    def evaluate(x: Array) -> Array:
        return np.array([_sum_splines(kind, x, {knot: 1.0}) for knot in knots])

    conditions = [evaluate(x) @ law(x) / fine for law in kind.laws()]
    if kind.is_gain:
        conditions.append(evaluate(np.array([low]))[:, 0])
    if not kind.extent.is_periodic:  # zero curvature at the ends
        bend = np.zeros(len(knots))
        bend[:3] = 1.0, -2.0, 1.0
        conditions += [bend, bend[::-1]]
    for knot in kind.extent.merged:  # the third derivative does not jump
        jump = np.zeros(len(knots))
        np.add.at(jump, (np.arange(knot - 2, knot + 3) - knots[0]) % len(knots), (1.0, -4.0, 6.0, -4.0, 1.0))
        conditions.append(jump)
    rows = np.array(conditions).reshape(-1, len(knots))  # a periodic table may have no conditions
    order = scipy.linalg.qr(rows, mode="r", pivoting=True)[1]
    bound, free = order[: len(rows)], np.sort(order[len(rows) :])
    shares = np.linalg.solve(rows[:, bound], rows[:, free])  # bound coefficients as combinations of the free ones
    return tuple(
        {knots[k]: 1.0}
        | {knots[b]: -float(share) for b, share in zip(bound, shares[:, column], strict=True) if abs(share) > 1e-9}
        for column, k in enumerate(free)
    )


@cache
def _make_columns(kind: type[Table]) -> tuple[Column, ...]:
    def law(weights: Mapping[int, float], x: Samples) -> ArrayLike:
        return _sum_splines(kind, kind.argument(x), weights)

    name = kind.id.partition("@")[0]
    return tuple(kind.column(f"{name}.{k}", partial(law, row)) for k, row in enumerate(_compute_weights(kind)))  # type: ignore[arg-type]


@dataclass(frozen=True)
class ByAngle(Table):
    """Function of the angle, periodic if the joint turned."""

    axis = "position"

    def covers(self, x: Samples) -> bool:
        position, extent = np.asarray(x.position), self.extent
        outside = np.mean((position < extent.low) | (position > extent.high))
        return extent.is_periodic or bool(outside < 1.0 / extent.pieces)

    @classmethod
    def argument(cls, x: Samples) -> ArrayLike:
        return x.position


@dataclass(frozen=True)
class TorqueByAngle(ByAngle):
    """Torque that is a function of the angle, as of a cable, a dress pack or a cam; over a turn where it turned."""

    id = "torque_by_angle"
    law = "f(q)"
    kind = "potential"

    def without_known_functions(self, terms: Sequence[Term]) -> Table:
        names = (name for term in terms if term.at in ("", self.at) for name in term.list_angle_functions(self.at))
        return self.with_extent(replace(self.extent, beside=tuple(dict.fromkeys(names))))()

    @classmethod
    def laws(cls) -> Sequence[Callable[[Array], Array]]:
        # a line is not periodic
        return [OF_ANGLE[name] for name in cls.extent.beside if not (name == "line" and cls.extent.is_periodic)]


@dataclass(frozen=True)
class FrictionByAngle(ByAngle):
    """Dry friction that varies with the angle, as of a seal that rubs or a worn part of a gear."""

    id = "friction_by_angle"
    law = "f(q) sgn q'"
    kind = "dissipative"
    is_dry = True

    @classmethod
    def laws(cls) -> Sequence[Callable[[Array], Array]]:
        return (np.ones_like,)


@dataclass(frozen=True)
class FrictionBySpeed(Table):
    """Friction that is any function of the speed, the same either way; knots are closer together at low speed."""

    id = "friction_by_speed"
    law = "f(|q'|) sgn q'"
    kind = "dissipative"
    axis = "velocity"
    extent = Extent(0.0, 1.0, 4)
    is_dry = True

    @classmethod
    def argument(cls, x: Samples) -> ArrayLike:
        return np.absolute(x.velocity)

    @classmethod
    def warp(cls, argument: ArrayLike) -> ArrayLike:
        return np.sqrt(argument)

    @classmethod
    def laws(cls) -> Sequence[Callable[[Array], Array]]:
        return (np.ones_like, np.positive)


@dataclass(frozen=True)
class PowerOfSpeed(Table):
    """Friction that grows with a power of the speed: two parameters."""

    power: float = 3.0

    id = "power_of_speed"
    axis = "velocity"
    law = "c |q'|^p sgn q'"
    kind = "dissipative"
    nonlinear_parameters = (NonlinearParameter("power", "1", 0.2, 9.0),)

    @property
    def columns(self) -> tuple[Column, ...]:
        return (Column(self.id, "N m (s/rad)^p", dry=lambda x: np.absolute(x.velocity) ** self.power),)


@dataclass(frozen=True)
class ByTime(Table):
    """Function of time in a single recording."""

    axis = "time"
    max_pieces: ClassVar[float] = np.inf  # largest number of pieces
    length: ClassVar[float] = 0.5  # [s], length of a piece, longer if `max_pieces` is reached

    def covers(self, x: Samples) -> bool:
        return False

    @classmethod
    def argument(cls, x: Samples) -> ArrayLike:
        return x.time


@dataclass(frozen=True)
class TorqueByTime(ByTime):
    """Torque that wanders slowly with time."""

    id = "torque_by_time"
    law = "f(t)"
    kind = "time-varying"


@dataclass(frozen=True)
class GainByTime(ByTime):
    """Motor gain that varies slowly with time: the joint receives tau (1 - f(t))."""

    id = "gain_by_time"
    law = "tau f(t)"
    kind = "actuation"
    unit = "1"
    is_gain = True
    max_pieces = 5  # slow: temperature of the motor, charge of a battery


def refuse_contained(terms: Iterable[Term], term: Term) -> None:
    """Refuse a new term with a function that a table of the model contains: the two would be indistinguishable.

    Raises:
        UserError: with both ids and the order in which they can be added.
    """
    for table in terms:
        if not isinstance(table, Table):
            continue
        if set(table.without_known_functions([term]).extent.beside) - set(table.extent.beside):
            raise UserError(f"'{table.id}' holds all that '{term.id}' is: add '{term.id}' first, then the table")


# tables that a model can keep
TABLES: dict[str, type[Term]] = {kind.id: kind for kind in (TorqueByAngle, FrictionByAngle, FrictionBySpeed)}


COMPETING: tuple[type[Term], ...] = (  # tables that compete with effects
    PowerOfSpeed,
    TorqueByAngle,
    FrictionByAngle,
    FrictionBySpeed,
    TorqueByTime,
    GainByTime,
)
