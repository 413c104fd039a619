"""Sections of a page."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Section:
    """Part of the page under one heading."""

    id: str  # anchor on the page, and name of the template
    short: str  # title in the navigation
    title: str  # heading
    content: Mapping[str, Any]  # what the template may use

    @property
    def template(self) -> str:
        """Return the file name of the template."""
        return f"{self.id}.html"
