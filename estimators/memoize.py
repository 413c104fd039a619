"""Methods that answer each question once."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

Owner = TypeVar("Owner")
Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")


def memoized(method: Callable[Concatenate[Owner, Asked], Answer]) -> Callable[Concatenate[Owner, Asked], Answer]:
    """Keep every answer of a method with its object, by positional arguments; lists count as tuples."""

    @wraps(method)
    def asked(self: Owner, /, *args: Asked.args, **named: Asked.kwargs) -> Answer:
        answers: dict[tuple[object, ...], Answer] = self.__dict__.setdefault("_kept", {})
        key = (method.__name__, *(tuple(one) if isinstance(one, list) else one for one in args))
        if key not in answers:
            answers[key] = method(self, *args, **named)
        return answers[key]

    return asked
