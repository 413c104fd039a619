"""What an exported file says of itself."""

from __future__ import annotations

import re
from collections.abc import Sequence

from pendulum_env.physics import Model


def title(model: Model) -> str:
    """What the file is of, fit for a comment in any language: a law is whatever its author wrote."""
    return f"A pendulum, as identified: {plain(' + '.join(term.law for term in model.terms))} = tau."


def plain(text: str) -> str:
    """Text that ends no comment and no string, in any language."""
    return " ".join(text.replace("*/", "* /").replace('"', "'").replace("\\", "/").split())


def comment(lines: Sequence[str]) -> str:
    """Text of a comment in XML, where two dashes would end it."""
    return re.sub("-(?=-)", "- ", "\n".join(lines))


def commented(xml: str, lines: Sequence[str]) -> str:
    """An XML file with a comment after its first line."""
    first, rest = xml.split("\n", 1)
    return f"{first}\n<!-- {comment(lines)} -->\n{rest}"
