"""Content of results, independent of its output: text, lists, tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Self

from pendulum_env._typing import JSON
from pendulum_env.formatting import TextTable
from workbench.figure import Figure


class Code(str):
    """Code to copy."""

    __slots__ = ()
    is_code = True


class Place(str):
    """Sentence on a region; a page links it to plots over time. `where`: axis, ends, joint and number of the model."""

    where: JSON

    def __new__(cls, text: str, where: JSON) -> Self:
        """Make the sentence."""
        place = super().__new__(cls, text)
        place.where = where
        return place


class Legend(NamedTuple):
    """Legend of several figures: kind, colour and label of each entry."""

    entries: tuple[tuple[str, str, str], ...]


class Part(NamedTuple):
    """Titled content; notebook and report fold it unless it is brief."""

    title: str
    content: Content
    brief: bool = True


class Evidence(NamedTuple):
    """Row on one effect: name, share of the error that it takes away, verdict and reason; its content is folded."""

    name: str
    share: float
    verdict: str
    reason: str
    content: Content


Content = Sequence[  # tuple of texts: list; tuple of figures: grid; mapping: head of a report
    str | tuple[str, ...] | TextTable | Figure | tuple[Figure, ...] | Legend | Part | Evidence | Mapping[str, Any]
]


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
