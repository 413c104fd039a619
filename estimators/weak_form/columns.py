"""Bounds of the parameters of terms, and their dependence on the torque."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Column, Model, Term, list_loads


def is_torque_dependent(*terms: Term) -> bool:
    """Return whether a column of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def has_known_parameter(*terms: Term) -> bool:
    """Return whether the value of a linear parameter of the terms is given and not fitted."""
    return any(column.is_known for term in terms for column in term.columns)


def list_bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return lower and upper bounds of the linear parameters of a model with some terms, (P,) each.

    They are the bounds of the laws. Parameters of columns `is_of_body` without a lower bound are at least zero, except
    friction at a joint with a table of friction.
    """
    tables = {at for term in terms if is_friction_table(term) for at in list_loads(term.at)}
    least, most = list_law_bounds(terms)
    is_body = np.array([_is_of_body(t, column, t.at in tables) for t in terms for column in t.columns], dtype=bool)
    least[is_body & (least == -np.inf) & (most > 0.0)] = 0.0
    return least, most


def list_law_bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return the lower and upper bounds of the laws alone, (P,) each; they may allow negative inertia."""
    columns = [column for term in terms for column in term.columns]
    return np.array([column.least for column in columns]), np.array([column.most for column in columns])


def is_friction_table(term: Term) -> bool:
    """Return whether a term is friction of any form, beside which base friction may have any sign."""
    return term.is_free_form and term.kind == "dissipative"


def _is_of_body(term: Term, column: Column, has_table: bool) -> bool:
    """Return whether the parameter of a column must not be negative, given a table of friction at its joint."""
    return column.is_of_body and not (has_table and term.kind == "dissipative")


def mark_bounds(model: Model) -> Model:
    """Return a fitted model with standard error zero of known parameters, and `at_bound` of parameters at a bound.

    These have the value of a bound of `list_bounds` and no standard error.
    """
    estimates = dict(model.estimates)
    for column, low, high in zip(model.columns, *list_bounds(model.terms), strict=True):
        estimate = estimates[column.name]
        if low == high:
            estimates[column.name] = replace(estimate, std=0.0)
        elif estimate.value in (low, high) and estimate.std == 0:
            estimates[column.name] = replace(estimate, at_bound=True)
    return replace(model, estimates=estimates)
