"""The three views of the torque balance, sample by sample, and which samples are clear of stick, in symbols."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from pendulum_env.physics import Samples, Term
from pendulum_env.physics.symbols import Operand, Symbol, names
from pendulum_env.physics.term import Law, zero

VIEWS = ("torque", "impulse", "energy")
TIME, POSITION, VELOCITY, ACCELERATION, TORQUE, HELD = range(6)  # of an instant, as in `Measurements`


class Course:
    """What was: values at the instants before, as states of a recurrence.

    Attributes:
        before: names of what is remembered.
        after: what it becomes.
    """

    def __init__(self) -> None:
        """Nothing is remembered yet."""
        self.before: dict[str, Any] = {}
        self.after: dict[str, Any] = {}

    def of(self, label: str, value: Any, times: int) -> list[Any]:
        """A value now, and as it was at so many instants before."""
        if not isinstance(value, Symbol):
            return (times + 1) * [value]
        past = names(label, times)
        self.before[label], self.after[label] = past, np.array([value, *past[:-1]])
        return [value, *past]


class Guarded(NamedTuple):
    """How far rows keep from stick and reversals.

    Attributes:
        distances: of each guard [samples]; None keeps even stick.
        behind: by how many samples rows are behind, the longest distance.
        lead_in: at the start, that are left out [samples].
        slowest: velocity that has a direction [rad/s].
    """

    distances: tuple[int | None, ...]
    behind: int
    lead_in: int
    slowest: float


def laws(terms: Sequence[Term]) -> dict[str, Law]:
    """What the columns of terms contribute to the balances, those of linear parameters first."""
    columns = [column for term in terms for column in term.columns]
    columns += [column for term in terms for column in term.fixed]
    parts: dict[str, Law] = {}
    for j, column in enumerate(columns):
        parts[f"mass.{j}"], parts[f"torque.{j}"] = column.mass, partial(column.torque, acceleration=0.0)
        parts[f"power.{j}"], parts[f"stored.{j}"] = column.power, column.potential or zero
    return parts


def rows(
    terms: Sequence[Term],
    index: Any,
    instant: Any,
    supplied: Any,
    memory: Mapping[str, Any],
    period: float,
    course: Course,
) -> tuple[Any, Any, dict[str, Symbol]]:
    """The three views at the instant before one, phi and, in the last place, y (3, P + 1).

    Takes the index of the instant in its run, its values (6,), the torque at the instant before and over the sample
    before that (2,), state variables of the terms by id, and the time between instants [s]. Also returns the velocity
    at the instant before, and what is to be given in the place of laws that are no formulas.
    """
    _, q, v, a, _, _ = instant
    x: Any = Samples(instant[TIME], q, v, instant[TORQUE])
    x = replace(x, memory={id: tuple(own) for id, own in memory.items()})
    own, parts = {}, {}
    for label, law in laws(terms).items():
        value = _formula(law, x)
        if value is None:
            value = own[label] = names(label)
        parts[label] = course.of(label, value, 3)

    def mean(values: list[Any]) -> Any:
        """Over the sample before the instant at which a view is taken, of fourth order as soon as there are four."""
        newest, at, older, oldest = values
        if not isinstance(newest, Symbol):
            return newest
        of_two, of_four = 0.5 * (at + older), (13 * (at + older) - (newest + oldest)) / 24
        return np.where(index == 2, of_two, of_four)

    _, position, last_position = course.of("position", q, 2)
    _, velocity, last_velocity = course.of("velocity", v, 2)
    _, acceleration = course.of("acceleration", a, 1)
    gained = (velocity - last_velocity) / period
    worked = (velocity * velocity - last_velocity * last_velocity) / (2 * period)
    found = []
    for j in range(len(parts) // 4):
        mass, torque, power, stored = (parts[f"{what}.{j}"] for what in ("mass", "torque", "power", "stored"))
        at_instant = mass[1] * acceleration + torque[1]
        impulse = mean(mass) * gained + mean(torque)
        energy = mean(mass) * worked + mean(power) + (stored[1] - stored[2]) / period
        found.append([at_instant, impulse, energy])
    count = sum(len(term.columns) for term in terms)
    y = [supplied[0], supplied[1], supplied[1] * ((position - last_position) / period)]
    y = [value - sum(row[k] for row in found[count:]) for k, value in enumerate(y)]
    return np.array([*found[:count], y], dtype=object).T, velocity, own


def clear_of_stick(guarded: Guarded, index: Any, velocity: Any, halts: Any, course: Course) -> Any:
    """For each guard, whether the sample `behind` the newest is clear of stick (G,).

    Takes index and velocity of the newest sample, and the index of the last halt as it was when the newest sample was
    as far ahead as each guard looks (G,); the longest guard looks at the newest.
    """
    halt, (_, last) = names("halt"), course.of("newest", velocity, 1)
    turned = (np.sign(velocity) != np.sign(last)) & (index > 0)
    halted = ((np.abs(velocity) <= guarded.slowest) | turned) & (index >= 0)
    course.before["halt"], course.after["halt"] = halt, np.where(halted, index, halt)
    told, clear = index - guarded.behind, []
    for distance, past in zip(guarded.distances, halts, strict=True):
        known = told >= guarded.lead_in
        if distance is not None:
            known = known & ((course.after["halt"] if distance == guarded.behind else past) < told - distance)
        clear.append(known)
    return np.array(clear, dtype=object)


def _formula(law: Law, x: Samples) -> Operand | None:
    """What a law comes to in symbols; None if it is no formula."""
    try:
        value = law(x)
    except Exception:  # a user's law may do anything that NumPy does
        return None
    return value if isinstance(value, Symbol) else float(value) if np.ndim(value) == 0 else None
