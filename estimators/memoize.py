"""Memoise the results of methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Params = ParamSpec("Params")
Result = TypeVar("Result")


def memoized(method: Callable[Concatenate[Owner, Params], Result]) -> Callable[Concatenate[Owner, Params], Result]:
    """Store each result of a method in its object, by all arguments, which are hashable; a list counts as a tuple.

    An argument given by name and the same by position are stored separately.
    """

    @wraps(method)
    def call_once(self: Owner, /, *args: Params.args, **keywords: Params.kwargs) -> Result:
        results: dict[tuple[object, ...], Result] = self.__dict__.setdefault("_kept", {})
        named = ((name, _freeze(keywords[name])) for name in sorted(keywords))
        key = (method.__name__, tuple(map(_freeze, args)), *named)
        if key not in results:
            results[key] = method(self, *args, **keywords)
        return results[key]

    return call_once


def _freeze(argument: object) -> object:
    """Return an argument as part of a key."""
    return tuple(argument) if isinstance(argument, list) else argument
