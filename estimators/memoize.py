"""Memoise the results of methods."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")


def memoized(method: Callable[Concatenate[Owner, Asked], Answer]) -> Callable[Concatenate[Owner, Asked], Answer]:
    """Store each result of a method in its object, by positional arguments; a list counts as a tuple.

    Keyword arguments are passed on, but not part of the key.
    """

    @wraps(method)
    def call_once(self: Owner, /, *args: Asked.args, **keywords: Asked.kwargs) -> Answer:
        answers: dict[tuple[object, ...], Answer] = self.__dict__.setdefault("_kept", {})
        key = (method.__name__, *(tuple(argument) if isinstance(argument, list) else argument for argument in args))
        if key not in answers:
            answers[key] = method(self, *args, **keywords)
        return answers[key]

    return call_once
