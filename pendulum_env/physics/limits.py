"""Bounds and known values of parameters, given by the user."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from numbers import Real
from typing import Any, cast

import numpy as np

from pendulum_env.errors import UserError
from pendulum_env.physics.term import Column, NonlinearParameter, Term, derive_kind
from pendulum_env.quantity import get_finite
from pendulum_env.reading import quote_value

Limits = Mapping[str, tuple[float, float]]  # least and largest value by name, `gravity` or `cogging.order`
Bounds = Mapping[str, tuple[float | None, float | None]]  # bounds of the user; None for no bound


def make_limits(fixed: Mapping[str, float], bounds: Bounds) -> dict[str, tuple[float, float]]:
    """Make limits from known values and from bounds.

    Raises:
        UserError: if a parameter is both fixed and bounded, or its limits are empty.
        TypeError: if a value is not a number, or a bound is not a pair.
    """
    values = {name: float(value) for name, value in _refuse_other_values(fixed, "fixed", "{'gravity': 2.0}").items()}
    ends = _refuse_other_values(bounds, "bounds", "{'viscous': (0.0, None)}", is_pair=True)
    ranges = {name: (-np.inf if a is None else a, np.inf if b is None else b) for name, (a, b) in ends.items()}
    repeated = sorted(set(fixed) & set(bounds))
    if repeated:
        raise UserError(f"{repeated[0]} is fixed and bounded: do one or the other")
    for name, (low, high) in ranges.items():
        if not low <= high:
            raise UserError(f"{name} cannot lie from {low:g} to {high:g}: give the smaller bound first")
    limits = {name: (value, value) for name, value in values.items()} | ranges
    for name, (low, high) in limits.items():
        if np.isnan([low, high]).any() or low == np.inf or high == -np.inf:
            raise UserError(f"{name} cannot be {low:g}: give a number")
        if name == "inertia" and high <= 0:
            raise UserError(f"inertia cannot be {high:g}: give a positive number")
    return limits


def _refuse_other_values(values: Any, argument: str, example: str, is_pair: bool = False) -> Mapping[str, Any]:
    """Refuse arguments that do not map names to numbers or, if `is_pair`, to pairs of numbers or None."""

    def is_valid(value: Any) -> bool:
        if not is_pair:
            return isinstance(value, Real)
        ends = value if isinstance(value, list | tuple) else ()
        return len(ends) == 2 and all(isinstance(end, Real | None) for end in ends)

    if not isinstance(values, Mapping):
        raise TypeError(f"{argument}={quote_value(values)}: give a dictionary, as in {example}")
    for name, value in values.items():
        if not is_valid(value):
            kind = "a pair of numbers in SI units, or None" if is_pair else "a number in SI units"
            raise TypeError(f"{argument} has {name}={quote_value(value)}: give {kind}, as in {example}")
    return values


def check_names(limits: Limits, kinds: Iterable[type[Term]]) -> None:
    """Refuse limits of unknown parameters, and empty limits.

    Raises:
        UserError: if a name is unknown, a nonlinear parameter is fixed, or the limits exclude all values.
    """
    terms = [kind() for kind in kinds]
    nonlinear = {f"{term.id}.{p.name}": p for term in terms for p in term.nonlinear_parameters}
    ranges = {column.name: (column.least, column.most) for term in terms for column in term.columns}
    ranges |= {name: (p.low, p.high) for name, p in nonlinear.items()}
    for name, (low, high) in limits.items():
        if name not in ranges:
            similar = difflib.get_close_matches(name, ranges, n=1)
            names = "parameters are named ID or ID.NAME, such as gravity or cogging.order"
            hint = f"did you mean {similar[0]}?" if similar else names
            raise UserError(f"unknown parameter '{name[:60]}': {hint}")
        if name in nonlinear and low == high:
            example = f"{0.99 * low:.4g} and {1.01 * low:.4g}"
            raise UserError(f"{name} is searched for and cannot be fixed: give it bounds, such as {example}")
        lowest, highest = ranges[name]
        if name in nonlinear and nonlinear[name].integer:
            low, high = _round_inwards(low, high)
            if low > high:
                raise UserError(f"{name} is a whole number, and none lies within its bounds: give wider ones")
        if low < high and max(low, lowest) > min(high, highest):
            raise UserError(f"{name} cannot lie from {low:g} to {high:g}: it lies from {lowest:g} to {highest:g}")


def limit_kind(kind: type[Term], limits: Limits) -> type[Term]:
    """Derive a kind of term with limited parameters; return the same kind without limits of its parameters.

    A parameter with equal limits is known: fits keep it, without standard error. New limits replace existing limits of
    the same parameters.
    """
    kind, earlier = getattr(kind, "bare", (kind, ()))
    names = {column.name for column in kind().columns} | {f"{kind.id}.{p.name}" for p in kind.nonlinear_parameters}
    by_name = {name: (low, high) for name, low, high in earlier}
    by_name |= {name: ends for name, ends in limits.items() if name in names}
    entries = tuple(sorted((name, low, high) for name, (low, high) in by_name.items()))
    return _make_limited_kind(kind, entries) if entries else kind  # type: ignore[arg-type]  # classes are hashable


def collect_limits(terms: Iterable[Term]) -> dict[str, tuple[float, float]]:
    """Collect the limits of the terms' parameters by name; both limits of a known value are equal."""
    entries_of_terms = (getattr(type(term), "bare", (type(term), ()))[1] for term in terms)
    return {name: (low, high) for entries in entries_of_terms for name, low, high in entries}


def write_limits(limits: Limits) -> dict[str, list[float | None]]:
    """Convert limits to bounds for JSON: `[low, high]`, with null for an infinite limit."""
    return {name: [*map(get_finite, ends)] for name, ends in limits.items()}


def limit_term(term: Term, limits: Limits) -> Term:
    """Limit the parameters of a term, and clip its nonlinear parameters."""
    kind = limit_kind(type(term), limits)
    return term if kind is type(term) else clip_term(kind(**term.nonlinear_values))


def release_term(term: Term) -> Term:
    """Free the known parameters of a term, and keep its bounds."""
    kind, limits = getattr(type(term), "bare", (type(term), ()))
    bounds = {name: (low, high) for name, low, high in limits if low < high}
    return term if len(bounds) == len(limits) else limit_kind(kind, bounds)(**term.nonlinear_values)


def _round_inwards(low: float, high: float) -> tuple[float, float]:
    """Return the least and the largest whole number within limits, which may be infinite."""
    return (float(np.ceil(low)), float(np.floor(high)))


@cache
def _make_limited_kind(kind: type[Term], limits: tuple[tuple[str, float, float], ...]) -> type[Term]:
    by_name = {name: (low, high) for name, low, high in limits}

    def limit_column(column: Column) -> Column:
        low, high = by_name.get(column.name, (column.least, column.most))
        if low < high:  # physical bounds also apply, except to known values
            low, high = max(low, column.least), min(high, column.most)
        return replace(column, least=low, most=high)

    def limit_nonlinear_parameter(p: NonlinearParameter) -> NonlinearParameter:
        low, high = by_name.get(f"{kind.id}.{p.name}", (p.low, p.high))
        if p.integer:
            low, high = _round_inwards(low, high)
        return replace(p, low=max(low, p.low), high=min(high, p.high))

    def columns(self: Term) -> tuple[Column, ...]:
        return tuple(limit_column(column) for column in cast(Any, super(limited, self)).columns)

    nonlinear = tuple(map(limit_nonlinear_parameter, kind.nonlinear_parameters))
    members = {"columns": property(columns), "nonlinear_parameters": nonlinear, "bare": (kind, limits)}
    limited = derive_kind(kind, _make_limited_kind, limits, **members)
    return limited


def clip_term(term: Term) -> Term:
    """Clip the nonlinear parameters of a term to their bounds, except nominal values."""
    values = term.nonlinear_values
    parameters = [p for p in term.nonlinear_parameters if values[p.name] != p.nominal]
    clipped = {p.name: float(min(max(values[p.name], p.low), p.high)) for p in parameters}
    return replace(term, **clipped) if any(clipped[name] != values[name] for name in clipped) else term
