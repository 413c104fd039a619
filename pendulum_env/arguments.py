"""Arguments of public functions: results and models come first, recordings next, paths last."""

from types import UnionType
from typing import Any

PLACES = ("first", "second", "third")
Kind = type[Any] | UnionType


def check_order(call: str, *given: tuple[object, Kind]) -> None:
    """Refuse an argument, or a list, that is of the kind of another argument.

    Args:
        call: the function with the names of its arguments, `compare(model, recordings)`.
        given: each argument with its kind.

    Raises:
        TypeError: if one is.
    """
    for k, (value, kind) in enumerate(given):
        first = value[0] if isinstance(value, list | tuple) and value else value
        if not isinstance(first, kind) and any(isinstance(first, other) for _, other in given):
            raise TypeError(
                f"{call}: the {PLACES[k]} argument is of type {type(first).__name__}: give the arguments in this "
                "order, or by name"
            )
