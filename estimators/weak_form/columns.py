"""Properties of the columns of terms: bounds of their parameters, and dependence on the torque."""

from collections.abc import Sequence

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.physics import Term


def depends_on_torque(*terms: Term) -> bool:
    """Return whether the torque of one of the terms depends on the commanded torque."""
    return any(term.fixed or any(column.of_torque for column in term.columns) for term in terms)


def is_known(*terms: Term) -> bool:
    """Return whether a linear parameter of the terms is given, and not to be fitted."""
    return any(column.is_known for term in terms for column in term.columns)


def bounds(terms: Sequence[Term]) -> tuple[Array, Array]:
    """Return lower and upper bounds of the linear parameters of some terms, (P,) each."""
    columns = [column for term in terms for column in term.columns]
    return np.array([column.least for column in columns]), np.array([column.most for column in columns])
