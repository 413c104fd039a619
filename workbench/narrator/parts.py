"""Content of results, independent of its output: text, lists, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from pendulum_env.formatting import TextTable
from workbench.figure import Figure


class Code(str):
    """Code to copy."""

    __slots__ = ()
    is_code = True


class Legend(NamedTuple):
    """Legend of several figures: kind, colour and label of each entry."""

    entries: tuple[tuple[str, str, str], ...]


class Part(NamedTuple):
    """Titled content; notebook and report fold it unless it is brief."""

    title: str
    content: Content
    brief: bool = True


Content = Sequence[  # tuple of texts: list; tuple of figures: grid; mapping: head of a report
    str | tuple[str, ...] | TextTable | Figure | tuple[Figure, ...] | Legend | Part | Mapping[str, Any]
]


def list_figures(content: Content) -> Iterator[Figure]:
    """Yield the figures in some content, in order."""
    for item in content:
        if isinstance(item, Figure):
            yield item
        elif isinstance(item, Part):
            yield from list_figures(item.content)
        elif isinstance(item, tuple):
            yield from (part for part in item if isinstance(part, Figure))


def list_texts(content: Content) -> Iterator[str | TextTable]:
    """Yield the texts and tables in some content, in order; each line of a list begins with a dash."""
    for item in content:
        if isinstance(item, str | TextTable):
            yield item
        elif isinstance(item, tuple):
            yield from (f"- {line}" for line in item)


def format_parts(parts: Sequence[Part]) -> str:
    """Format titles, texts, lists and tables of a result as plain text, with a blank line between parts."""
    return "\n\n".join("\n".join([part.title, *map(str, list_texts(part.content))]) for part in parts)
