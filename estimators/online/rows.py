"""Step of a stream by one instant, in symbols: rows of the torque balance, detection of stick, equations of schemes."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from estimators.schemes.six import VIEWS, Integral, LowPass, Scheme, compute_decay
from pendulum_env._typing import ArrayLike
from pendulum_env.physics import Column, Samples, Term
from pendulum_env.physics.compiled import SymbolicStep
from pendulum_env.physics.simulation import TorqueBalance
from pendulum_env.physics.symbols import Operand, Symbol, make_symbols
from pendulum_env.physics.term import Law, return_zero

TIME, POSITION, VELOCITY, ACCELERATION, TORQUE, HELD = range(INSTANT := 6)  # values of an instant, as in `Measurements`


class StickGuards(NamedTuple):
    """Distances of rows from stick and reversals.

    Attributes:
        distances: distance of each guard [samples]; None keeps rows in stick.
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
        laws[f"power.{j}"], laws[f"stored.{j}"] = column.power, column.potential or return_zero
    return laws


def list_filtered_forces(terms: Sequence[Term]) -> dict[int, Law]:
    """List the forces of the angle alone, of columns with a potential, by the index of `list_laws`.

    They are filtered, as in `Measurements.compute_force`: the force at a smoothed position differs in fast rotation.
    """
    columns = [*(column for term in terms for column in term.columns), *(c for term in terms for c in term.fixed)]
    forces = {j: partial(_compute_conservative_force, c) for j, c in enumerate(columns) if c.potential is not None}
    x: Any = Samples(*make_symbols("sample", 4))
    return {j: force for j, force in forces.items() if isinstance(_evaluate_formula(force, x), Symbol)}


def _compute_conservative_force(column: Column, x: Samples) -> ArrayLike:
    """Compute the force of a potential per unit of the parameter, without its dissipative part."""
    return column.force(x) - column.loss(x)


def list_guards(schemes: Sequence[Scheme]) -> tuple[float | None, ...]:
    """List the different guards of schemes [s]."""
    return tuple(dict.fromkeys(scheme.guard for scheme in schemes))


def list_windows(schemes: Sequence[Scheme], period: float) -> list[int]:
    """List the numbers of rows in the sums of integral schemes; 0 sums from the start."""
    return [scheme.operator.samples(period) for scheme in schemes if isinstance(scheme.operator, Integral)]


def write_step(terms: Sequence[Term], schemes: Sequence[Scheme], guards: StickGuards, period: float) -> SymbolicStep:
    """Write the step by one instant, up to the equations of the sample `behind` the newest.

    Inputs:
        index, newest: index of the newest instant, and its velocity that shows stick and reversals.
        instant: values of the instant `behind` - 1 before the newest, and its filtered forces (6 + F,).
        measured: position of this instant without added noise.
        supplied: delayed torque at the row and over the sample before it (2,); only with a delay.
        memory.ID: states of the term `ID`.
        halts: index of the last halt at the distance of each guard (G,).
        oldest: sums of each integral scheme one window ago, with their numbers of clear rows (K, P + 2).
        Labels of `list_laws`: values of laws that are no formulas.

    Results:
        equations: phi and y of each scheme (S, P + 1), equal to those of `Scheme.regression`.
        usable: mask of the usable equations (S,).
        regressor: row of the torque balance, 0 in stick (P,).
    """
    return _StepWriter(terms, schemes, guards, period).write()


class _StepWriter:
    """Writer of a step: its inputs, its states `before`, and their values `after`."""

    def __init__(self, terms: Sequence[Term], schemes: Sequence[Scheme], guards: StickGuards, period: float) -> None:
        self.terms, self.schemes, self.guards, self.period = terms, schemes, guards, period
        self.before: dict[str, Any] = {}
        self.after: dict[str, Any] = {}
        self.inputs: dict[str, Any] = {}
        self.index, self.newest = self.add_input("index"), self.add_input("newest")
        self.forces = list_filtered_forces(terms)
        self.instant = self.add_input("instant", INSTANT + len(self.forces))

    def write(self) -> SymbolicStep:
        """Write the step."""
        views, velocity = self.write_balance()
        clear, moving = self.find_clear(), np.abs(velocity) > self.guards.slowest
        equations, usable = self.apply_schemes(views, clear, moving)
        results = {"regressor": _apply_gate(views[0, :-1], clear[0]), "equations": equations, "usable": usable}
        return SymbolicStep(self.inputs, self.before, self.after | results)

    def add_history(self, label: str, value: Any, times: int) -> list[Any]:
        """Return a scalar now and at `times` >= 1 past instants, the newest first.

        A value other than a symbol, also an array of symbols, is treated as constant and repeated.
        """
        if not isinstance(value, Symbol):
            return (times + 1) * [value]
        past = make_symbols(label, times)
        self.before[label], self.after[label] = past, np.array([value, *past[:-1]])
        return [value, *past]

    def add_input(self, label: str, *shape: int) -> Any:
        """Return an input of the step."""
        self.inputs[label] = make_symbols(label, *shape)
        return self.inputs[label]

    def write_balance(self) -> tuple[Any, Any]:
        """Return the row of the second-newest instant in the three views (3, P + 1), and its velocity."""
        instant, period = self.instant, self.period
        if any(term.delay for term in self.terms):
            supplied = self.add_input("supplied", 2)
        else:
            supplied = [self.add_history(f"supplied.{k}", instant[k], 1)[1] for k in (TORQUE, HELD)]
        _, q, v, a, _, _, *filtered = instant
        theta = np.ones(sum(len(term.columns) for term in self.terms))
        at_rest = TorqueBalance(self.terms, theta).start(Samples(*np.zeros((4, 1))))
        memory = {id: tuple(self.add_input(f"memory.{id}", len(states))) for id, states in at_rest.items()}
        x: Any = replace(Samples(instant[TIME], q, v, instant[TORQUE]), memory=memory)
        corrections: dict[str, Any] = {}
        measured = replace(x, position=self.add_input("measured"))
        for (j, force), value in zip(self.forces.items(), filtered, strict=True):
            correction = value - force(measured)  # added noise of the position stays in the force
            corrections |= {f"torque.{j}": correction, f"power.{j}": correction * v}
        laws = {}
        for label, law in list_laws(self.terms).items():
            value = _evaluate_formula(law, x)
            if value is not None and label in corrections:
                value = value + corrections[label]
            laws[label] = self.add_history(label, self.add_input(label) if value is None else value, 3)
        is_second = self.index - (self.guards.behind - 1) == 2  # instant since the start

        def average(values: list[Any]) -> Any:
            """Average over the sample before the instant of the view, of fourth order with four values."""
            newest, at, older, oldest = values
            if not isinstance(newest, Symbol):
                return newest
            of_two, of_four = 0.5 * (at + older), (13 * (at + older) - (newest + oldest)) / 24
            return np.where(is_second, of_two, of_four)

        _, position, last_position = self.add_history("position", q, 2)
        _, velocity, last_velocity = self.add_history("velocity", v, 2)
        _, acceleration = self.add_history("acceleration", a, 1)
        acceleration_mean = (velocity - last_velocity) / period
        kinetic_rate = (velocity * velocity - last_velocity * last_velocity) / (2 * period)
        rows = []
        for j in range(len(laws) // 4):
            mass, torque, power, stored = (laws[f"{part}.{j}"] for part in ("mass", "torque", "power", "stored"))
            at_instant = mass[1] * acceleration + torque[1]
            impulse = average(mass) * acceleration_mean + average(torque)
            energy = average(mass) * kinetic_rate + average(power) + (stored[1] - stored[2]) / period
            rows.append([at_instant, impulse, energy])
        applied, last_applied = self.add_history("applied", supplied[0], 1)
        power = supplied[1] * ((position - last_position) / period)
        y = [applied, supplied[1], power + (applied - last_applied) * (velocity - last_velocity) / 12]
        y = [value - sum(row[k] for row in rows[len(theta) :]) for k, value in enumerate(y)]
        return np.array([*rows[: len(theta)], y], dtype=object).T, velocity

    def find_clear(self) -> Any:
        """Return for each guard whether the sample `behind` the newest is clear of stick (G,)."""
        guards, index, velocity = self.guards, self.index, self.newest
        halts = self.add_input("halts", len(guards.distances))
        halt, (_, last) = make_symbols("halt"), self.add_history("newest", velocity, 1)
        turned = (np.sign(velocity) != np.sign(last)) & (index > 0)
        halted = ((np.abs(velocity) <= guards.slowest) | turned) & (index >= 0)
        self.before["halt"], self.after["halt"] = halt, np.where(halted, index, halt)
        row_index, clear = index - guards.behind, []
        for distance, past in zip(guards.distances, halts, strict=True):
            is_clear = row_index >= guards.lead_in
            if distance is not None:
                last_halt = self.after["halt"] if distance == guards.behind else past
                is_clear = is_clear & (last_halt < row_index - distance)
            clear.append(is_clear)
        return np.array(clear, dtype=object)

    def apply_schemes(self, views: Any, clear: Any, moving: Any) -> tuple[Any, Any]:
        """Return the equations of the schemes (S, P + 1), which start from rest, and whether each is usable (S,)."""
        period, before, after, index = self.period, self.before, self.after, self.index - self.guards.behind
        guards, windows, width = list_guards(self.schemes), list_windows(self.schemes, self.period), views.shape[1]
        oldest = self.add_input("oldest", len(windows), width + 1)
        before["clear"], after["clear"] = make_symbols("clear", len(guards)), clear
        before["moving"], after["moving"] = make_symbols("moving"), moving
        before["total"] = make_symbols("total", len(windows), width + 1)
        after["total"] = before["total"].copy()
        equations, usable, window_numbers = [], [], itertools.count()
        for s, scheme in enumerate(self.schemes):
            guard = guards.index(scheme.guard)
            gate = clear[guard]
            if scheme.view != "torque":  # over the step up to the sample
                gate = gate * before["clear"][guard]
            if scheme.view == "energy":
                gate = gate * moving * before["moving"]
            row = _apply_gate(views[list(VIEWS).index(scheme.view)], gate)
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


def _evaluate_formula(law: Law, x: Samples) -> Operand | None:
    """Evaluate a law in symbols; return None if it is no formula."""
    try:
        value = law(x)
    except Exception:  # a law of the user may call any function
        return None
    return value if isinstance(value, Symbol) else float(value) if np.ndim(value) == 0 else None


def _apply_gate(row: Any, gate: Any) -> Any:
    """Set a row (P,) to zero where a gate is closed, also where the row is not finite."""
    return np.array([np.where(gate, value, 0.0) for value in row], dtype=object)
