"""Compare a table with five families of formulas: a wave, a straight line, a bump, a step, and a power of the speed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
import scipy

from estimators.regression.least_squares import solve_least_squares
from estimators.selection.criterion import Criterion
from pendulum_env._typing import Array
from pendulum_env.physics.table import Table, TableCurve

Form = Literal["wave", "line", "bump", "step", "power"]
Formula = Callable[..., Sequence[Array]]  # of the argument (N,) and nonlinear parameters: columns (N,) or constants


@dataclass(frozen=True)
class LikenessSettings:
    """Which formulas a table is compared with, and which of them it looks like."""

    most: int = 3  # formulas that are reported
    least: float = 0.5  # share of the shape, below which it looks like nothing of the kind,
    by_chance: float = Criterion.p_value  # and probability that a random shape comes as near, above which it does not
    alike: float = 1e-3  # share that is left, below which none is nearer than another
    widths: tuple[float, float] = (0.02, 1.0)  # shares of the table, from which to which a bump or a step may reach
    powers: tuple[float, float] = (0.1, 9.0)  # of the speed, from which to which they are searched for
    orders: range = range(1, 25)  # of waves over a turn


LIKENESS = LikenessSettings()


class Family(NamedTuple):
    """Formulas of one kind; their nonlinear parameters are searched for between their ends, from the starts."""

    form: Form
    formula: Formula
    starts: Sequence[tuple[float, ...]] = ((),)
    ends: Sequence[tuple[float, float]] = ()
    known: tuple[float, ...] = ()


@dataclass(frozen=True)
class Likeness:
    """A formula, and the share of the table's variance that it explains."""

    form: Form
    values: tuple[float, ...]  # of the nonlinear parameters; of a wave, its number in a turn
    share: float
    parameters: int


def find_likenesses(table: Table, curve: TableCurve) -> list[Likeness]:
    """Find the formulas of three kinds that are nearest to a table, the nearest first; fewer if none is near.

    They are fitted to the table where it is told best, beside what the model has of its argument. Of a formula with
    more parameters nothing is said unless it leaves less than half of what simpler ones do: a line is also a wide step.
    The share that k parameters explain of a random table of P has a beta distribution with k/2 and (P - k)/2; a formula
    is reported if the best of all families rarely reaches its share by chance.
    """
    base = np.column_stack([np.empty((len(curve.x), 0)), *(law(curve.x) for law in type(table).laws())])
    usual = max(float(np.median(curve.std)), 1e-3 * float(np.ptp(curve.value)), 1e-300)
    weights = 1.0 / np.maximum(curve.std, usual)  # no point counts for more than half of them do
    whole, constant = (
        _compute_residual_squares(curve, base, weights),
        [np.ones_like(curve.x)] * (table.axis == "position"),
    )
    found = []
    for family in _list_families(table):

        def left(shape: Array, formula: Formula = family.formula) -> float:
            with np.errstate(all="ignore"):
                columns = np.column_stack([*constant, *formula(curve.x, *shape)])
            return _compute_residual_squares(
                curve, np.column_stack([base, np.nan_to_num(columns, nan=0.0, posinf=0.0, neginf=0.0)]), weights
            )

        start = min(family.starts, key=lambda values: left(np.array(values)))
        shape = np.array(start)
        if start:
            shape = scipy.optimize.minimize(
                left, start, method="Nelder-Mead", bounds=family.ends, options={"maxiter": 200}
            ).x
        count = len(constant) + len(family.formula(curve.x[:1], *shape)) + len(shape)
        found.append(Likeness(family.form, (*family.known, *shape.tolist()), 1.0 - left(shape) / whole, count))
    found.sort(key=lambda one: -one.share)
    near = [one for one in found if one.share > LIKENESS.least and _is_significant(one, len(table.columns), len(found))]
    return [one for one in near if not any(_is_enough(other, one) for other in found)][: LIKENESS.most]


def _is_significant(one: Likeness, freedom: int, families: int) -> bool:
    """Return whether a formula explains more of a table than the best of several families would of a random table."""
    spare = freedom - one.parameters
    chance = scipy.special.betainc(0.5 * spare, 0.5 * one.parameters, 1.0 - one.share) if spare > 0 else 1.0
    return bool(families * chance <= LIKENESS.by_chance)


def _is_enough(simple: Likeness, other: Likeness) -> bool:
    """Return whether one formula makes another one unnecessary."""
    left, less = (max(1.0 - one.share, LIKENESS.alike) for one in (simple, other))
    return simple.parameters < other.parameters and left < 2.0 * less


def _compute_residual_squares(curve: TableCurve, columns: Array, weights: Array) -> float:
    """Compute the weighted residual sum of squares of a fit of columns (N, K)."""
    scaled, target = columns * weights[:, None], weights * curve.value
    return float(np.sum((target - scaled @ solve_least_squares(scaled, target)) ** 2))


def _list_families(table: Table) -> list[Family]:
    low, high = table.extent[:2]
    if table.axis == "velocity":
        return [Family("power", lambda v, p: (v**p,), [(p,) for p in (0.2, 0.5, 1.5, 2.0, 3.0)], (LIKENESS.powers,))]
    places = np.linspace(low, high, 25)[1:-1].tolist()
    around = list(product(places, ((high - low) * np.array([0.03, 0.08, 0.2, 0.5])).tolist()))
    at, wide = (low, high), ((high - low) * LIKENESS.widths[0], (high - low) * LIKENESS.widths[1])
    waves = [
        Family("wave", lambda q, n=n: (np.sin(n * q), np.cos(n * q)), known=(n,))
        for n in (() if table.slides else LIKENESS.orders)
    ]
    return [
        *waves,
        Family("line", lambda q: (q,)),
        Family("bump", lambda q, a, w: (np.exp(-(((q - a) / w) ** 2)),), around, (at, wide)),
        Family("step", lambda q, a, w: (np.tanh((q - a) / w),), around, (at, wide)),
    ]
