"""Rows of the torque balance in its three views, detection of stick, and equations of schemes, as recurrences."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from estimators.schemes.six import Integral, LowPass, Scheme, compute_decay
from pendulum_env.physics import Samples, Term
from pendulum_env.physics.symbols import Operand, Symbol, make_symbols
from pendulum_env.physics.term import Law, zero

VIEWS = ("torque", "impulse", "energy")
TIME, POSITION, VELOCITY, ACCELERATION, TORQUE, HELD = range(6)  # values of an instant, as in `Measurements`


class History:
    """Values at past instants, as states of a recurrence.

    Attributes:
        before: symbols of the states.
        after: their values after the next step.
    """

    def __init__(self) -> None:
        """Create a history without states."""
        self.before: dict[str, Any] = {}
        self.after: dict[str, Any] = {}

    def remember(self, label: str, value: Any, times: int) -> list[Any]:
        """Return a scalar now and at `times` >= 1 past instants, the newest first.

        A value that is no symbol, such as an array of symbols, counts as constant, and is repeated.
        """
        if not isinstance(value, Symbol):
            return (times + 1) * [value]
        past = make_symbols(label, times)
        self.before[label], self.after[label] = past, np.array([value, *past[:-1]])
        return [value, *past]


class StickGuards(NamedTuple):
    """Distances of rows from stick and reversals.

    Attributes:
        distances: of each guard [samples]; None keeps rows in stick.
        behind: delay of the rows, which is the longest distance [samples].
        lead_in: samples at the start that are left out.
        slowest: least velocity with a direction [rad/s].
    """

    distances: tuple[int | None, ...]
    behind: int
    lead_in: int
    slowest: float


def list_laws(terms: Sequence[Term]) -> dict[str, Law]:
    """List the four laws of each column of terms by label; columns with linear parameters come first.

    The labels of column j are mass.j, torque.j (at zero acceleration), power.j and stored.j.
    """
    columns = [column for term in terms for column in term.columns]
    columns += [column for term in terms for column in term.fixed]
    laws: dict[str, Law] = {}
    for j, column in enumerate(columns):
        laws[f"mass.{j}"], laws[f"torque.{j}"] = column.mass, partial(column.torque, acceleration=0.0)
        laws[f"power.{j}"], laws[f"stored.{j}"] = column.power, column.potential or zero
    return laws


def compute_balance_rows(
    terms: Sequence[Term],
    index: Any,
    instant: Any,
    supplied: Any,
    memory: Mapping[str, Any],
    period: float,
    history: History,
) -> tuple[Any, Any, dict[str, Symbol]]:
    """Compute the row of the last but one instant in the three views.

    Args:
        terms: of the model.
        index: of the newest instant since the start.
        instant: values of the newest instant (6,).
        supplied: torque at the last but one instant, and over the sample before it (2,).
        memory: states of the terms by id.
        period: between instants [s].
        history: where values of earlier instants are kept.

    Returns:
        phi and, in the last column, y (3, P + 1); the velocity at that instant; and symbols of the laws that are no
        formulas, whose values must be given.
    """
    _, q, v, a, _, _ = instant
    x: Any = Samples(instant[TIME], q, v, instant[TORQUE])
    x = replace(x, memory={id: tuple(states) for id, states in memory.items()})
    law_symbols, laws = {}, {}
    for label, law in list_laws(terms).items():
        value = _evaluate_formula(law, x)
        if value is None:
            value = law_symbols[label] = make_symbols(label)
        laws[label] = history.remember(label, value, 3)

    def average(values: list[Any]) -> Any:
        """Average over the sample before the instant of the view, of fourth order with four values."""
        newest, at, older, oldest = values
        if not isinstance(newest, Symbol):
            return newest
        of_two, of_four = 0.5 * (at + older), (13 * (at + older) - (newest + oldest)) / 24
        return np.where(index == 2, of_two, of_four)

    _, position, last_position = history.remember("position", q, 2)
    _, velocity, last_velocity = history.remember("velocity", v, 2)
    _, acceleration = history.remember("acceleration", a, 1)
    acceleration_mean = (velocity - last_velocity) / period
    kinetic_rate = (velocity * velocity - last_velocity * last_velocity) / (2 * period)
    rows = []
    for j in range(len(laws) // 4):
        mass, torque, power, stored = (laws[f"{part}.{j}"] for part in ("mass", "torque", "power", "stored"))
        at_instant = mass[1] * acceleration + torque[1]
        impulse = average(mass) * acceleration_mean + average(torque)
        energy = average(mass) * kinetic_rate + average(power) + (stored[1] - stored[2]) / period
        rows.append([at_instant, impulse, energy])
    count = sum(len(term.columns) for term in terms)
    y = [supplied[0], supplied[1], supplied[1] * ((position - last_position) / period)]
    y = [value - sum(row[k] for row in rows[count:]) for k, value in enumerate(y)]
    return np.array([*rows[:count], y], dtype=object).T, velocity, law_symbols


def compute_stick_mask(guards: StickGuards, index: Any, velocity: Any, halts: Any, history: History) -> Any:
    """Compute for each guard whether the sample `behind` the newest is clear of stick (G,).

    Args:
        guards: distances of the guards.
        index: of the newest sample.
        velocity: of the newest sample [rad/s].
        halts: index of the last halt for each guard, as of the sample at the distance of the guard (G,).
        history: states of the recurrence.
    """
    halt, (_, last) = make_symbols("halt"), history.remember("newest", velocity, 1)
    turned = (np.sign(velocity) != np.sign(last)) & (index > 0)
    halted = ((np.abs(velocity) <= guards.slowest) | turned) & (index >= 0)
    history.before["halt"], history.after["halt"] = halt, np.where(halted, index, halt)
    row_index, clear = index - guards.behind, []
    for distance, past in zip(guards.distances, halts, strict=True):
        known = row_index >= guards.lead_in
        if distance is not None:
            known = known & ((history.after["halt"] if distance == guards.behind else past) < row_index - distance)
        clear.append(known)
    return np.array(clear, dtype=object)


def _evaluate_formula(law: Law, x: Samples) -> Operand | None:
    """Evaluate a law in symbols; return None if it is no formula."""
    try:
        value = law(x)
    except Exception:  # a law of the user may call any function
        return None
    return value if isinstance(value, Symbol) else float(value) if np.ndim(value) == 0 else None


def list_guards(schemes: Sequence[Scheme]) -> tuple[float | None, ...]:
    """List the different guards of schemes [s]."""
    return tuple(dict.fromkeys(scheme.guard for scheme in schemes))


def apply_gate(row: Any, gate: Any) -> Any:
    """Set a row (P,) to zero where a gate is closed, also where the row is not finite."""
    return np.array([np.where(gate, value, 0.0) for value in row], dtype=object)


def list_windows(schemes: Sequence[Scheme], period: float) -> list[int]:
    """List the numbers of rows in the sums of integral schemes; 0 sums from the start."""
    return [scheme.operator.samples(period) for scheme in schemes if isinstance(scheme.operator, Integral)]


def update_scheme_equations(
    schemes: Sequence[Scheme],
    views: Any,
    clear: Any,
    moving: Any,
    oldest: Any,
    index: Any,
    period: float,
    history: History,
) -> tuple[Any, Any]:
    """Update the equations of S schemes with one row, starting from rest.

    For a whole recording, the equations equal those of `Scheme.regression`.

    Args:
        schemes: S of them.
        views: the row in each view (3, P + 1).
        clear: whether the row is clear of stick, for each guard (G,).
        moving: whether the joint moves at the sample.
        oldest: sums of integral schemes one window ago, with their numbers of clear rows (K, P + 2).
        index: of the row since the start.
        period: between rows [s].
        history: states of the recurrence.

    Returns:
        phi and, in the last column, y (S, P + 1); and whether each equation is usable (S,).
    """
    guards, windows, width = list_guards(schemes), list_windows(schemes, period), views.shape[1]
    before, after = history.before, history.after
    before["clear"], after["clear"] = make_symbols("clear", len(guards)), clear
    before["moving"], after["moving"] = make_symbols("moving"), moving
    before["total"] = make_symbols("total", len(windows), width + 1)
    after["total"] = before["total"].copy()
    equations, usable, window_numbers = [], [], itertools.count()
    for s, scheme in enumerate(schemes):
        guard = guards.index(scheme.guard)
        gate = clear[guard]
        if scheme.view != "torque":  # over the step up to the sample
            gate = gate * before["clear"][guard]
        if scheme.view == "energy":
            gate = gate * moving * before["moving"]
        row = apply_gate(views[VIEWS.index(scheme.view)], gate)
        if isinstance(scheme.operator, LowPass):
            gain = 1.0 - compute_decay(scheme.operator.cutoff, period)
            for stage in range(scheme.operator.order):
                label = f"filter.{s}.{stage}"
                before[label] = make_symbols(label, width)
                after[label] = row = before[label] + gain * (row - before[label])
        if isinstance(scheme.operator, Integral):
            k = next(window_numbers)
            after["total"][k] = total = before["total"][k] + np.array([*row * period, gate], dtype=object)
            *row, n_clear = total - (oldest[k] if windows[k] else 0.0)
            gate = (2 * n_clear >= windows[k] if windows[k] else gate) & (index >= max(1, windows[k]))
        equations.append(row)
        usable.append(gate)
    return np.array(equations), np.array(usable, dtype=object)
