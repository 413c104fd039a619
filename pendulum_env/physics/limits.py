"""Limits that a user sets to the parameters of terms, and values that are known."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cache
from numbers import Real
from typing import Any, cast

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.mistake import Mistake
from pendulum_env.physics.term import Column, Samples, Shape, Term, derived
from pendulum_env.reading import shown

Limits = Mapping[str, tuple[float, float]]  # least and largest value by parameter, `gravity` or `cogging.order`
Bounds = Mapping[str, tuple[float | None, float | None]]  # as a user gives them: None is no limit


class LimitsError(Mistake):
    """Limits that make no sense; the message says which and why."""


def limits_of(fixed: Mapping[str, float], bounds: Bounds) -> dict[str, tuple[float, float]]:
    """Limits from known values and from bounds.

    Raises:
        LimitsError: if a parameter is named twice, or its limits leave nothing.
        TypeError: if values are no numbers, or bounds no pairs of them.
    """
    known = {name: float(value) for name, value in _numbers(fixed, "fixed", "{'gravity': 2.0}").items()}
    ends = _numbers(bounds, "bounds", "{'viscous': (0.0, None)}", is_pair=True)
    bounded = {name: (-np.inf if a is None else a, np.inf if b is None else b) for name, (a, b) in ends.items()}
    twice = sorted(set(fixed) & set(bounds))
    if twice:
        raise LimitsError(f"{twice[0]} is fixed and bounded: do one or the other")
    for name, (low, high) in bounded.items():
        if not low <= high:
            raise LimitsError(f"{name} cannot lie from {low:g} to {high:g}: give the smaller bound first")
    limits = {name: (value, value) for name, value in known.items()} | bounded
    for name, (low, high) in limits.items():
        if np.isnan([low, high]).any() or low == np.inf or high == -np.inf:
            raise LimitsError(f"{name} cannot be {low:g}: give a number")
        if name == "inertia" and high <= 0:
            raise LimitsError(f"inertia cannot be {high:g}: give a positive number")
    return limits


def _numbers(given: Any, argument: str, example: str, is_pair: bool = False) -> Mapping[str, Any]:
    """Refuse arguments that are no mapping of names to numbers, or to pairs of numbers or None."""

    def is_right(value: Any) -> bool:
        if not is_pair:
            return isinstance(value, Real)
        ends = value if isinstance(value, list | tuple) else ()
        return len(ends) == 2 and all(isinstance(end, Real | None) for end in ends)

    if not isinstance(given, Mapping) or not all(map(is_right, given.values())):
        raise TypeError(f"{argument}={shown(given)}: give a dictionary, as in {example}")
    return given


def check_names(limits: Limits, kinds: Iterable[type[Term]]) -> None:
    """Refuse limits of parameters that no term has.

    Raises:
        LimitsError: if a name is unknown or belongs to a parameter whose value cannot be fixed, or no value is left.
    """
    terms = [kind() for kind in kinds]
    shapes = {f"{term.id}.{shape.name}": shape for term in terms for shape in term.shapes}
    columns = {column.name: column for term in terms for column in term.columns}
    for name, (low, high) in limits.items():
        if name not in {**columns, **shapes}:
            near = difflib.get_close_matches(name, [*columns, *shapes], n=1)
            hint = f"did you mean {near[0]}?" if near else "`effects` lists those of effects, by ID or ID.NAME"
            raise LimitsError(f"unknown parameter '{name[:60]}': {hint}")
        if name in shapes and low == high:
            raise LimitsError(f"{name} is searched for and cannot be fixed: give it bounds")
        least, most = (
            (shapes[name].low, shapes[name].high) if name in shapes else (columns[name].least, columns[name].most)
        )
        if low < high and max(low, least) > min(high, most):
            raise LimitsError(f"{name} cannot lie from {low:g} to {high:g}: it lies from {least:g} to {most:g}")


def limited(kind: type[Term], limits: Limits) -> type[Term]:
    """A kind of term whose parameters stay within limits; the same kind if none are its own.

    A parameter whose limits are one value is known: fits keep it, and it has no standard error. Of a kind that has
    limits already, new ones of the same parameters take their place.
    """
    kind, held = getattr(kind, "bare", (kind, ()))
    own = {column.name for column in kind().columns} | {f"{kind.id}.{shape.name}" for shape in kind.shapes}
    merged = {name: (low, high) for name, low, high in held} | {name: limits[name] for name in limits if name in own}
    chosen = tuple(sorted((name, low, high) for name, (low, high) in merged.items()))
    return _limited(kind, chosen) if chosen else kind  # type: ignore[arg-type]  # classes can be hashed


def collect_limits(terms: Iterable[Term]) -> dict[str, tuple[float, float]]:
    """Limits that a user set to parameters of terms, by name; a known value is both."""
    held = (getattr(type(term), "bare", (type(term), ()))[1] for term in terms)
    return {name: (low, high) for own in held for name, low, high in own}


def write_limits(limits: Limits) -> dict[str, list[float | None]]:
    """Limits for JSON: `[low, high]`, null for none."""
    return {name: [end if np.isfinite(end) else None for end in ends] for name, ends in limits.items()}


def read_limits(content: Mapping[str, tuple[float | None, float | None]]) -> dict[str, tuple[float, float]]:
    """Limits as `write_limits` wrote them.

    Raises:
        LimitsError: if they leave no value.
    """
    return limits_of({}, content)


def limited_term(term: Term, limits: Limits) -> Term:
    """A term with its parameters within limits, its shape parameters moved there."""
    kind = limited(type(term), limits)
    return term if kind is type(term) else _clipped(kind(**term.shape))


@cache
def _limited(kind: type[Term], limits: tuple[tuple[str, float, float], ...]) -> type[Term]:
    by_name = {name: (low, high) for name, low, high in limits}

    def within(column: Column) -> Column:
        low, high = by_name.get(column.name, (column.least, column.most))
        if low < high:  # a user's bounds are within those of a body; what is known is known
            low, high = max(low, column.least), min(high, column.most)
        return replace(column, least=low, most=high)

    def narrower(shape: Shape) -> Shape:
        low, high = by_name.get(f"{kind.id}.{shape.name}", (shape.low, shape.high))
        return replace(shape, low=max(low, shape.low), high=min(high, shape.high))

    def columns(self: Term) -> tuple[Column, ...]:
        return tuple(within(column) for column in cast(Any, super(made, self)).columns)

    def grid(cls: type[Term], x: Samples, residual: Array) -> Iterable[Term]:
        return dict.fromkeys(_clipped(variant) for variant in cast(Any, super(made, cls)).grid(x, residual))

    shapes = tuple(narrower(shape) for shape in kind.shapes)
    made = derived(
        kind, _limited, limits, columns=property(columns), shapes=shapes, grid=classmethod(grid), bare=(kind, limits)
    )
    return made


def _clipped(term: Term) -> Term:
    inside = {
        shape.name: float(np.clip(term.shape[shape.name], shape.low, shape.high))
        for shape in term.shapes
        if term.shape[shape.name] != shape.usual
    }
    return replace(term, **inside)
