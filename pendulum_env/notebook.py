"""HTML by which results show themselves in a notebook: cards of words, tables and small curves.

A cell has no style sheet of its own and may be light or dark, so that everything is styled in place, in the text's own
colour and three colours that are seen on either. Whatever goes in is escaped, names of recordings and effects included.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import singledispatch
from html import escape
from importlib import import_module
from typing import NamedTuple

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.formatting import TextTable
from pendulum_env.thinning import thin

BLUE, ORANGE, GREEN = "#3d85d8", "#d9792a", "#2f9e77"  # 3 : 1 or more on white and on black
WIDTH, HEIGHT = 600, 64  # of a curve, in its own units
NARRATOR = "workbench.narrator.notebook"  # module that shows results of estimators
LINE = "border-bottom:1px solid rgba(128,128,128,.3)"
SMALL = "font-size:.88em;opacity:.8"


class Html(str):
    """Markup that may go into markup as it is."""

    __slots__ = ()


@singledispatch
def shown(result: object) -> str:
    """A result as HTML; each kind of result is registered where it is known how to show it.

    The narrator of the workbench registers the results of the libraries; it is loaded, by name, when first needed.
    """
    import_module(NARRATOR)
    show = shown.dispatch(type(result))
    if show is shown.dispatch(object):
        raise TypeError(f"{type(result).__name__} has no HTML form")
    return show(result)


@singledispatch
def headline(result: object) -> str:
    """A result in one sentence, registered as `shown`."""
    import_module(NARRATOR)
    narrate = headline.dispatch(type(result))
    if narrate is headline.dispatch(object):
        raise TypeError(f"there is no headline of a {type(result).__name__}")
    return narrate(result)


def markup(content: object) -> Html:
    """Convert text to markup by escaping it."""
    return content if isinstance(content, Html) else Html(escape(str(content)))


def element(tag: str, style: str, *content: object) -> Html:
    """An element with its content, escaped unless it is markup."""
    return Html(f'<{tag} style="{style}">{"".join(map(markup, content))}</{tag}>')


def card(title: str, *parts: Html) -> str:
    """A result as one block: its title and what there is to show."""
    first = element("div", "font-weight:600;font-size:1.12em;margin-bottom:.3em", title)
    return element("div", "max-width:62em;line-height:1.45;overflow-x:auto", first, *parts)


def heading(text: str) -> Html:
    """Title of a part."""
    return element("div", "font-weight:600;margin:.7em 0 .15em", text)


def paragraph(text: str) -> Html:
    """A sentence or several."""
    return element("div", "margin:.15em 0", text)


def note(text: str) -> Html:
    """A remark in small print."""
    return element("div", f"margin:.15em 0;{SMALL}", text)


def bullets(lines: Iterable[str]) -> Html:
    """A list; nothing if there are no lines."""
    entries = [element("li", "margin:.1em 0", line) for line in lines]
    return element("ul", "margin:.2em 0;padding-left:1.3em", *entries) if entries else Html()


def folded(title: str, *parts: Html) -> Html:
    """Render a part that is collapsed at first."""
    summary = element("summary", "cursor:pointer;margin:.5em 0 .2em", title)
    return element("details", "", summary, *parts)


def table(content: TextTable) -> Html:
    """Rows of words under their headers; blocks are drawn as bars."""
    left = [k == 0 or header in content.left for k, header in enumerate(content.headers)]

    def row(tag: str, style: str, cells: Sequence[str]) -> Html:
        return element("tr", "background:none", *(cell(tag, style, k, text) for k, text in enumerate(cells)))

    def cell(tag: str, style: str, place: int, text: str) -> Html:
        bar = f"color:{BLUE};letter-spacing:-.05em;" if text.startswith("█") else ""
        wrap = "normal" if tag == "th" or (place > 0 and left[place]) else "nowrap"
        layout = f"padding:.22em .75em .22em 0;vertical-align:top;{LINE};white-space:{wrap}"
        return element(tag, f"{layout};text-align:{'left' if left[place] else 'right'};{bar}{style}", text)

    # a unit stays on one line
    headers = [re.sub(r"\[.*?\]", lambda unit: unit[0].replace(" ", "\xa0"), text) for text in content.headers]
    head = row("th", "font-weight:500;opacity:.75", headers)
    body = [row("td", "font-variant-numeric:tabular-nums", cells) for cells in content.rows]
    parts = element("thead", "", head), element("tbody", "", *body)
    return element("table", "border-collapse:collapse;border:0;margin:.3em 0;font-size:.92em", *parts)


class Curve(NamedTuple):
    """Values (N,) over what all curves of a plot share, and how they are drawn."""

    values: Array
    color: str
    dashed: bool = False


def legend(entries: Iterable[tuple[str, Curve]]) -> Html:
    """Names of curves, each in its colour."""
    line = "display:inline-block;width:1.6em;margin:0 .4em .25em 0;border-top:2px"
    keys = []
    for name, curve in entries:
        drawn = element("span", f"{line} {'dashed' if curve.dashed else 'solid'} {curve.color}")
        keys.append(element("span", "margin-right:1.2em;white-space:nowrap", drawn, name))
    return element("div", SMALL, *keys)


def plot(
    label: str,
    x: Array,
    curves: Sequence[Curve],
    noise: Array | None = None,
    span: tuple[float, float] | None = None,
) -> Html:
    """Small plot of curves over x, between the lowest and the highest value, which are printed.

    Args:
        label: what is seen, with its unit.
        x: abscissa, increasing (N,).
        curves: what is drawn.
        noise: half width of a band about zero (N,).
        span: lowest and highest value shown; what is beyond is cut off.
    """
    seen = np.concatenate([curve.values for curve in curves])
    low, high = span or (float(seen.min()), float(seen.max()))
    room = (high - low) or 1.0

    def path(x_values: Array, y_values: Array) -> str:
        across = WIDTH * (x_values - x[0]) / ((x[-1] - x[0]) or 1.0)
        down = np.clip(HEIGHT * (high - y_values) / room, -HEIGHT, 2 * HEIGHT)
        return "M" + "L".join(f"{a:.0f} {b:.1f}" for a, b in zip(across, down, strict=True))

    shapes = []
    if low < 0 < high:
        shapes.append(f'<path d="M0 {HEIGHT * high / room:.1f}H{WIDTH}" stroke="currentColor" stroke-opacity=".25"/>')
    if noise is not None:
        band = path(np.r_[x, x[::-1]], np.r_[noise, -noise[::-1]])
        shapes.append(f'<path d="{band}Z" fill="currentColor" fill-opacity=".18"/>')
    for curve in curves:
        kept = thin(curve.values, 480)
        dashes = ' stroke-dasharray="5 3"' if curve.dashed else ""
        line = f'd="{path(x[kept], curve.values[kept])}" stroke="{curve.color}"{dashes}'
        shapes.append(f'<path {line} fill="none" stroke-width="1.4" vector-effect="non-scaling-stroke"/>')
    drawing = Html(
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" role="img" aria-label="{escape(label)}" '
        f'style="display:block;width:100%;height:{HEIGHT}px;overflow:hidden">{"".join(shapes)}</svg>'
    )
    limits = element("span", "white-space:nowrap;margin-left:1em", f"{low:.3g} to {high:.3g}")
    caption = element("div", f"display:flex;justify-content:space-between;{SMALL}", element("span", "", label), limits)
    return element("div", "max-width:42em;margin:.35em 0", caption, drawing)
