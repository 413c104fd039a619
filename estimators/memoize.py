"""Memoise the results of methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Params = ParamSpec("Params")
Result = TypeVar("Result")


def memoized(method: Callable[Concatenate[Owner, Params], Result]) -> Callable[Concatenate[Owner, Params], Result]:
    """Store each result of a method in its object, by positional arguments; a list counts as a tuple.

    Keyword arguments are passed on, but not part of the key.
    """

    @wraps(method)
    def call_once(self: Owner, /, *args: Params.args, **keywords: Params.kwargs) -> Result:
        results: dict[tuple[object, ...], Result] = self.__dict__.setdefault("_kept", {})
        key = (method.__name__, *(tuple(argument) if isinstance(argument, list) else argument for argument in args))
        if key not in results:
            results[key] = method(self, *args, **keywords)
        return results[key]

    return call_once
