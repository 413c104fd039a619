"""A section of the report: one function that makes it and one template that shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Section:
    """What the page shows under one heading.

    Attributes:
        id: anchor on the page, and name of the template.
        short: title in the navigation.
        title: heading.
        content: what the template may use.
    """

    id: str
    short: str
    title: str
    content: Mapping[str, Any]

    @property
    def template(self) -> str:
        """File name of the template."""
        return f"{self.id}.html"
