"""What a browser would make of a page."""

import json
import re
from html.parser import HTMLParser


class Page(HTMLParser):
    """What a browser would make of the page: tags with their attributes, text outside scripts, and figures."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.figures: list[dict] = []
        self._inside = ""
        self.feed(text)
        self.text = re.sub(r"\s+", " ", self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = dict(attrs).get("type") or tag if tag in ("script", "style") else self._inside

    def handle_endtag(self, tag: str) -> None:
        self._inside = "" if tag in ("script", "style") else self._inside

    def handle_data(self, data: str) -> None:
        if self._inside == "application/json":
            self.figures.append(json.loads(data))
        elif not self._inside:
            self.text += data


def values(found: Page, attribute: str) -> list[str]:
    return [attrs[attribute] or "" for _, attrs in found.tags if attribute in attrs]
