"""Compare a table with five families of formulas: a wave, a straight line, a bump, a step, and a power of the speed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
import scipy

from estimators.decisions.criterion import Criterion
from estimators.regression.least_squares import solve_least_squares
from pendulum_env._typing import Array
from pendulum_env.physics.table import Table, TableCurve

Form = Literal["wave", "line", "bump", "step", "power"]
Formula = Callable[..., Sequence[Array]]  # of the argument (N,) and nonlinear parameters: columns (N,) or constants

MAX_FORMULAS = 3  # largest number of reported formulas
MIN_SHARE = 0.5  # share of the table's variance that a reported formula explains
MAX_P_VALUE = Criterion.p_value  # largest probability that a random table gives the same share
EQUAL_RESIDUAL = 1e-3  # unexplained share below which formulas count as equal
WIDTHS = (0.02, 1.0)  # range of the width of bumps and steps, shares of the table's range
POWERS = (0.1, 9.0)  # range of the power of the speed
ORDERS = range(1, 25)  # of waves per turn


class Family(NamedTuple):
    """Formulas of one kind.

    Attributes:
        form: kind of the formulas.
        formula: columns of the linear parameters, as a function of the argument and the nonlinear parameters.
        starts: start values of the nonlinear parameters.
        ends: range of each nonlinear parameter.
        known: values that the formula already contains.
    """

    form: Form
    formula: Formula
    starts: Sequence[tuple[float, ...]] = ((),)
    ends: Sequence[tuple[float, float]] = ()
    known: tuple[float, ...] = ()


@dataclass(frozen=True)
class Likeness:
    """Formula with its share of a table's variance.

    Attributes:
        form: kind of the formula.
        values: nonlinear parameters; of a wave, its number per turn.
        share: explained share of the table's weighted variance.
        parameters: number of all parameters.
    """

    form: Form
    values: tuple[float, ...]
    share: float
    parameters: int


def find_likenesses(table: Table, curve: TableCurve) -> list[Likeness]:
    """Find at most `MAX_FORMULAS` formulas that resemble a table, the largest explained share first.

    They are fitted to the curve of the table, weighted by its standard errors, in addition to the base laws of its
    argument. A formula with more parameters must leave less than half of the residual of simpler ones. The share that
    k parameters explain of a random table of P has a beta distribution with k/2 and (P - k)/2; a formula is reported if
    the best of all families rarely reaches its share by chance.
    """
    base = np.column_stack([np.empty((len(curve.x), 0)), *(law(curve.x) for law in type(table).laws())])
    typical_std = max(float(np.median(curve.std)), 1e-3 * float(np.ptp(curve.value)), 1e-300)
    weights = 1.0 / np.maximum(curve.std, typical_std)  # no weight is above that of the median error
    total = _compute_residual_squares(curve, base, weights)
    constant = [np.ones_like(curve.x)] * (table.axis == "position")
    fits = []
    for family in _list_families(table):

        def residual_of(shape: Array, formula: Formula = family.formula) -> float:  # residual sum of squares
            with np.errstate(all="ignore"):
                columns = np.column_stack([*constant, *formula(curve.x, *shape)])
            columns = np.nan_to_num(columns, nan=0.0, posinf=0.0, neginf=0.0)
            return _compute_residual_squares(curve, np.column_stack([base, columns]), weights)

        start = min(family.starts, key=lambda values: residual_of(np.array(values)))
        shape = np.array(start)
        if start:
            shape = scipy.optimize.minimize(
                residual_of, start, method="Nelder-Mead", bounds=family.ends, options={"maxiter": 200}
            ).x
        count = len(constant) + len(family.formula(curve.x[:1], *shape)) + len(shape)
        fits.append(Likeness(family.form, (*family.known, *shape.tolist()), 1.0 - residual_of(shape) / total, count))
    fits.sort(key=lambda likeness: -likeness.share)
    large = (likeness for likeness in fits if likeness.share > MIN_SHARE)
    similar = [likeness for likeness in large if _is_significant(likeness, len(table.columns), len(fits))]
    return [nearest for nearest in similar if not any(_is_enough(other, nearest) for other in fits)][:MAX_FORMULAS]


def _is_significant(likeness: Likeness, freedom: int, families: int) -> bool:
    """Return whether a formula explains more of a table than the best of several families would of a random table."""
    freedom_left = freedom - likeness.parameters
    if freedom_left <= 0:
        return False
    p_value = scipy.special.betainc(0.5 * freedom_left, 0.5 * likeness.parameters, 1.0 - likeness.share)
    return bool(families * p_value <= MAX_P_VALUE)


def _is_enough(simpler: Likeness, other: Likeness) -> bool:
    """Return whether a simpler formula leaves less than twice the residual of another."""
    simple_residual, other_residual = (max(1.0 - likeness.share, EQUAL_RESIDUAL) for likeness in (simpler, other))
    return simpler.parameters < other.parameters and simple_residual < 2.0 * other_residual


def _compute_residual_squares(curve: TableCurve, columns: Array, weights: Array) -> float:
    """Return the weighted residual sum of squares of a fit of columns (N, K) to a curve, with weights (N,)."""
    scaled, target = columns * weights[:, None], weights * curve.value
    return float(np.sum((target - scaled @ solve_least_squares(scaled, target)) ** 2))


def _list_families(table: Table) -> list[Family]:
    """List the families for a table: powers over speed; waves of a turning joint, lines, bumps and steps over angle."""
    low, high = table.extent.low, table.extent.high
    if table.axis == "velocity":
        return [Family("power", lambda v, p: (v**p,), [(p,) for p in (0.2, 0.5, 1.5, 2.0, 3.0)], (POWERS,))]
    places = np.linspace(low, high, 25)[1:-1].tolist()
    starts = list(product(places, ((high - low) * np.array([0.03, 0.08, 0.2, 0.5])).tolist()))
    places_range, widths = (low, high), ((high - low) * WIDTHS[0], (high - low) * WIDTHS[1])
    waves = [
        Family("wave", lambda q, n=n: (np.sin(n * q), np.cos(n * q)), known=(n,))
        for n in (() if table.is_prismatic else ORDERS)
    ]
    return [
        *waves,
        Family("line", lambda q: (q,)),
        Family("bump", lambda q, a, w: (np.exp(-(((q - a) / w) ** 2)),), starts, (places_range, widths)),
        Family("step", lambda q, a, w: (np.tanh((q - a) / w),), starts, (places_range, widths)),
    ]
