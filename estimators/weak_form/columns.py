"""Properties of the columns of terms: bounds of their parameters, and dependence on the torque."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Model, Table, Term, list_loads

NOT_NEGATIVE = ("inertia", "viscous", "coulomb")  # parameters of any body; gravity may have either sign


def is_torque_dependent(*terms: Term) -> bool:
    """Return whether the torque of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def is_known(*terms: Term) -> bool:
    """Return whether a linear parameter of the terms is given, and not to be fitted."""
    return any(column.is_known for term in terms for column in term.columns)


def list_bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return lower and upper bounds of the linear parameters of a model with some terms, (P,) each.

    Every fit of every candidate keeps them: those of each law, and those of a body, whose inertia and friction are not
    negative. Beside a table of friction, viscous and dry friction are only parts of friction, and have any sign. Limits
    that a user has set to a parameter take the place of those of a body.
    """
    tables = {
        at for term in terms if isinstance(term, Table) and term.kind == "dissipative" for at in list_loads(term.at)
    }
    least, most = bounds_of_laws(terms)
    is_body = np.array([_is_of_body(term, term.at in tables) for term in terms for _ in term.columns], dtype=bool)
    least[is_body & (least == -np.inf) & (most > 0.0)] = 0.0
    return least, most


def bounds_of_laws(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return the bounds of the laws alone, (P,) each: a fit within them shows data that no body fits."""
    columns = [column for term in terms for column in term.columns]
    return np.array([column.least for column in columns]), np.array([column.most for column in columns])


def _is_of_body(term: Term, has_table: bool) -> bool:
    """Return whether no body has a negative parameter of a term."""
    return term.id.partition("@")[0] in NOT_NEGATIVE and not (has_table and term.kind == "dissipative")


def mark_bounds(model: Model) -> Model:
    """Return a fitted model whose known estimates have no error; those at a bound of a body, without one, are marked.

    Estimates at the bounds of laws are marked already.
    """
    estimates = dict(model.estimates)
    for column, low, high in zip(model.columns, *list_bounds(model.terms), strict=True):
        own = estimates[column.name]
        if low == high:
            estimates[column.name] = replace(own, std=0.0)
        elif own.value in (low, high) and own.std == 0:
            estimates[column.name] = replace(own, at_bound=True)
    return replace(model, estimates=estimates)
