"""Parameters of a model in a search: terms with their linear parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimators.weak_form.columns import list_bounds
from estimators.weak_form.nonlinear import list_continuous_parameters, list_nonlinear_names, set_values
from pendulum_env._typing import Array
from pendulum_env.physics import Model, Term


class Point(NamedTuple):
    """Terms with nonlinear parameters set, and linear parameters theta (P,): a point of a search."""

    terms: tuple[Term, ...]
    theta: Array

    @property
    def values(self) -> Array:
        """Return all free parameters (P + S,): linear, then continuous nonlinear parameters."""
        nonlinear = [
            term.nonlinear_values[parameter.name]
            for term in self.terms
            for parameter in list_continuous_parameters(term)
        ]
        return np.concatenate([self.theta, nonlinear])

    @property
    def linear_values(self) -> dict[str, float]:
        """Return the linear parameters by name."""
        names = (column.name for term in self.terms for column in term.columns)
        return dict(zip(names, self.theta.tolist(), strict=True))

    @property
    def named_values(self) -> dict[str, float]:
        """Return all free parameters by name."""
        nonlinear = self.values[len(self.theta) :].tolist()
        return self.linear_values | dict(zip(list_nonlinear_names(self.terms), nonlinear, strict=True))

    @classmethod
    def from_model(cls, model: Model) -> Point:
        """Return the point of a model."""
        return cls(model.terms, np.asarray(model.theta, dtype=float))

    @classmethod
    def from_parameters(cls, terms: Sequence[Term], theta: Array) -> Point:
        """Return the point of terms and parameters (P,), clipped to their bounds."""
        point = cls(tuple(terms), np.asarray(theta, dtype=float))
        return point.with_values(point.values)

    def with_values(self, values: Array) -> Point:
        """Return the point with other values (P + S,), clipped to their bounds.

        Nonlinear parameters that follow a linear parameter take its value before clipping; without it, 0.
        """
        nonlinear = list(values[len(self.theta) :])
        linear, terms = Point(self.terms, values[: len(self.theta)]).linear_values, []
        for term in self.terms:
            parameters = list_continuous_parameters(term)
            term_values, nonlinear = np.array(nonlinear[: len(parameters)]), nonlinear[len(parameters) :]
            term = set_values(term, parameters, term_values) if parameters else term
            following = {
                parameter.name: linear.get(parameter.follows, 0.0)
                for parameter in term.nonlinear_parameters
                if parameter.follows
            }
            terms.append(replace(term, **following))
        return Point(tuple(terms), np.clip(values[: len(self.theta)], *list_bounds(terms)))
