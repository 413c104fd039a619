"""Find values by name; the error suggests the nearest known name."""

import difflib
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import ParamSpec, TypeVar

from pendulum_env.errors import UserError

P = ParamSpec("P")
T = TypeVar("T")

READING = ("columns", "unwrap", "drive")  # arguments of `read_recording` alone


class UnknownName(UserError, KeyError):
    """Unknown name."""

    __str__ = Exception.__str__  # KeyError.__str__ quotes the message


def find(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Find the value of a name.

    Raises:
        UnknownName: if the name is unknown; the message has the nearest name and all known names.
    """
    if name not in known:
        name = str(name)
        name = name if len(name) <= 60 else f"{name[:57]}..."
        similar = difflib.get_close_matches(name, known, n=1)
        hint = f": did you mean {similar[0]}? Known: " if similar else "; known: "
        raise UnknownName(f"unknown {kind} '{name}'{hint}{', '.join(sorted(known))}")
    return known[name]


def refuse_unknown_arguments(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function to refuse an unknown keyword with the nearest known one."""
    known = dict(inspect.signature(function).parameters)
    known.pop("self", None)

    @functools.wraps(function)
    def call_with_known_arguments(*args: P.args, **keywords: P.kwargs) -> T:
        for name in keywords:
            if name in READING and name not in known:
                raise UnknownName(f"'{name}' is an argument of read_recording: read with it, and give the recording")
            find("argument", name, known)
        return function(*args, **keywords)

    return call_with_known_arguments
