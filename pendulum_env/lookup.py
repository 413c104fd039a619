"""Finding things by name, with an answer that helps when there is nothing of that name."""

import difflib
from collections.abc import Mapping
from typing import TypeVar

from pendulum_env.mistake import Mistake

T = TypeVar("T")


class UnknownName(Mistake, KeyError):
    """There is nothing of that name."""

    __str__ = Exception.__str__  # a KeyError would quote the sentence


def find(kind: str, name: str, known: Mapping[str, T]) -> T:
    """What is known under that name.

    Raises:
        UnknownName: if nothing is; the message names the nearest and all that exist.
    """
    if name not in known:
        name = str(name)
        name = name if len(name) <= 60 else f"{name[:57]}..."  # as much as a sentence quotes
        near = difflib.get_close_matches(name, known, n=1)
        hint = f": did you mean {near[0]}? Known: " if near else "; known: "
        raise UnknownName(f"unknown {kind} '{name}'{hint}{', '.join(sorted(known))}")
    return known[name]
