"""What a browser would make of a page."""

import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser

from workbench.figure import Figure
from workbench.narrator.parts import Part


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


def list_figures(content) -> Iterator[Figure]:
    """The figures in content of a report, in order."""
    for item in content:
        if isinstance(item, Figure):
            yield item
        elif isinstance(item, Part | tuple):
            yield from list_figures(item.content if isinstance(item, Part) else item)


def values(found: Page, attribute: str) -> list[str]:
    return [attrs[attribute] or "" for _, attrs in found.tags if attribute in attrs]


def whole(text: str) -> Page:
    """A page that loads nothing, links to nothing that it has not, and has its figures' colours in light and dark."""
    found = Page(text)
    ids, links = values(found, "id"), values(found, "href")
    assert values(found, "src") == [] and len(ids) == len(set(ids))
    assert set(links) <= {f"#{id}" for id in ids}
    assert not any(tag in ("link", "iframe", "img", "object", "embed") for tag, _ in found.tags)
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)[1]
    assert "url(" not in style and "@import" not in style
    for color in set(re.findall(r'"(--[a-z0-9-]+)"', json.dumps(found.figures))):
        assert style.count(f"{color}:") == 2, f"{color} in light and dark"
    return found
