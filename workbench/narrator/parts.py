"""Content of results: parts with text, lists, tables and figures, which terminal, notebook and report render."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pendulum_env.formatting import TextTable
from workbench.figure import Figure


class Code(str):
    """Text to copy."""

    __slots__ = ()
    is_code = True


class Key(NamedTuple):
    """Meaning of the curves of several figures: kind, colour and label of each."""

    entries: tuple[tuple[str, str, str], ...]


class Part(NamedTuple):
    """Content under a title; a notebook and a report fold a part that is not brief."""

    title: str
    content: Content
    brief: bool = True


Content = Sequence[  # a tuple of texts is a list of points, a tuple of figures a grid, a mapping the head of a report
    str | tuple[str, ...] | TextTable | Figure | tuple[Figure, ...] | Key | Part | Mapping[str, Any]
]


def list_figures(content: Content) -> Iterator[Figure]:
    """List the figures in some content, in order."""
    for item in content:
        if isinstance(item, Figure):
            yield item
        elif isinstance(item, Part):
            yield from list_figures(item.content)
        elif isinstance(item, tuple):
            yield from (part for part in item if isinstance(part, Figure))
