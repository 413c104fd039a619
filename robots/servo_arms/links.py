"""Torque of the links at one joint of an arm while the other joints move as measured.

The torque at a revolute joint with angle q is linear in the base parameters w_k of the links, in the unit of the drive:

    sum_k w_k (m_k(t) q'' + c_k(t) cos q + s_k(t) sin q + f_k(t))

Gravity is a sine of q with a phase that depends on the other joints; m_k is the inertia at the joint, and f_k the
torque by the motion of the other joints. All are regressors of the robot file at the measured motion. Free first
moments absorb wrong zeros of parallel joints.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, ClassVar, cast

import numpy as np

from pendulum_env._typing import Array, ArrayLike
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.physics.symbols import Symbol
from pendulum_env.physics.term import Memory, derive_kind

SERIES = 4  # for each column: m_k, c_k, s_k and f_k


@dataclass(frozen=True, eq=False)
class LinkTable:
    """Regressors at a joint over time.

    Attributes:
        names: of the columns (K,).
        time: instants (N,) [s].
        series: m_k, c_k, s_k and f_k of each column in turn (N, 4 K).
        shares: parameters that stand for each base parameter of the arm, first the inertia at the joint, then those of
            the columns (K + 1, P); empty if unknown.
    """

    names: tuple[str, ...]
    time: Array
    series: Array
    shares: Array = field(default_factory=lambda: np.empty((0, 0)))

    def interpolate(self, time: Array) -> list[Array]:
        """Return the series at some instants."""
        return [np.interp(time, self.time, series) for series in self._rows]

    @cached_property
    def _rows(self) -> Array:
        """Return the series as contiguous rows (4 K, N), which need no copy in each interpolation."""
        return np.ascontiguousarray(self.series.T)


@dataclass(frozen=True)
class LinkTorque(Term):
    """Torque of the links at a joint, by the measured motion of the other joints."""

    id = "links"
    law = "sum_k w_k (m_k(t) q'' + c_k(t) cos q + s_k(t) sin q + f_k(t))"
    kind = "potential"
    is_decentralised = False
    is_weight = True
    has_links = True
    needs = "position"  # of the other joints
    table: ClassVar[LinkTable]

    @property
    def columns(self) -> tuple[Column, ...]:
        """Return one column for each first moment."""
        return tuple(_make_column(self, name, k) for k, name in enumerate(self.table.names))

    def start(self, x: Samples) -> Memory:
        """Return the series at an instant; in symbols, simulations replace them by those of each step."""
        time: object = x.time
        if isinstance(time, Symbol):
            return tuple(0.0 * x.position for _ in range(SERIES * len(self.table.names)))
        shape = np.broadcast_shapes(np.shape(x.time), np.shape(x.position))
        return tuple(np.broadcast_to(series, shape) for series in self.table.interpolate(x.time))

    def advance(self, memory: Memory, x: Samples, duration: ArrayLike) -> Memory:
        """Return the same series; simulations replace them in each step."""
        return tuple(series + 0.0 for series in memory)

    def list_known_states(self, time: Array) -> list[Array]:
        """Return the series at some instants."""
        return self.table.interpolate(time)

    def trace(self, x: Samples, command: Array, period: float) -> Memory:
        """Return the series along recorded samples, (N,) each."""
        return self.start(x)


def _make_column(term: LinkTorque, name: str, k: int) -> Column:
    def read(x: Samples) -> Any:
        states = x.memory.get(term.id) or term.list_known_states(x.time)
        return states[SERIES * k : SERIES * (k + 1)]

    def force(x: Samples) -> Any:
        _, cosine, sine, other = read(x)
        return cosine * np.cos(x.position) + sine * np.sin(x.position) + other

    unit = "kg m" if name.startswith("m") else "kg m^2"
    return Column(f"{LinkTorque.id}.{name}", unit, mass=lambda x: read(x)[0], force=force)


@cache
def make_link_torque(kind: type[LinkTorque], table: LinkTable) -> type[LinkTorque]:
    """Return the kind of term with a table."""
    return derive_kind(kind, make_link_torque, table, table=table)


def select_columns(columns: Array, first: Array, least: float) -> list[int]:
    """Return the columns (N, P) whose part that is independent of others and of `first` has a norm above `least`."""
    chosen = list[int]()
    rest, unit = columns, first / max(float(np.linalg.norm(first)), 1e-300)
    while len(chosen) < columns.shape[1]:
        rest = rest - np.outer(unit, unit @ rest)
        sizes = np.linalg.norm(rest, axis=0)
        best = int(np.argmax(sizes))
        if not sizes[best] > least:
            break
        chosen.append(best)
        unit = rest[:, best] / sizes[best]
    return sorted(chosen)


def remove_weight(kind: type[Term]) -> type[Term]:
    """Return an effect without the columns that depend on the weight of a pendulum."""
    return _remove_weight(cast(Hashable, kind))


@cache
def _remove_weight(kind: type[Term]) -> type[Term]:
    if not any(column.is_of_weight for column in kind().columns):
        return kind
    followed = {p.name for p in kind.nonlinear_parameters if p.follows == "gravity"}
    parameters = tuple(p for p in kind.nonlinear_parameters if p.name not in followed)

    def list_columns(term: Any) -> tuple[Column, ...]:
        return tuple(column for column in super(lighter, term).columns if not column.is_of_weight)

    lighter = derive_kind(kind, remove_weight, nonlinear_parameters=parameters, columns=property(list_columns))
    return lighter


def list_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of base parameters as parts of a column's name, `mx_Elbow` for `mx@Elbow`."""
    return tuple(name.replace("@", "_") for name in names)


def find_table(terms: Sequence[Term]) -> LinkTable | None:
    """Return the regressors of the links in a model of a servo; None without links."""
    return next((term.table for term in terms if isinstance(term, LinkTorque)), None)


def list_link_columns(terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the names of the columns of the links in a model of a servo."""
    table = find_table(terms)
    return () if table is None else table.names
