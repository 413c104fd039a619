"""HTML elements of results in a notebook: cards of text, tables and small curves.

Styles are inline, in the colour of the text and three colours visible in light and dark themes. Content is escaped.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from pendulum_env._typing import Array
from pendulum_env.formatting import PARTS, TextTable
from pendulum_env.notebook import BLUE
from workbench.figure import select_samples
from workbench.narrator.parts import Part

WIDTH, HEIGHT = 600, 64  # of a plot [SVG units]
LINE = "border-bottom:1px solid rgba(128,128,128,.3)"
SMALL = "font-size:.88em;opacity:.8"


class Html(str):
    """Markup that needs no escaping."""

    __slots__ = ()


def make_element(tag: str, style: str, *content: object) -> Html:
    """Make an element with a style; content other than `Html` is escaped."""
    parts = (item if isinstance(item, Html) else escape(str(item)) for item in content)
    return Html(f'<{tag} style="{style}">{"".join(parts)}</{tag}>')


def make_card(title: str, *content: object) -> str:
    """Make a card with a title and the content rendered by `render_content`."""
    first = make_element("div", "font-weight:600;font-size:1.12em;margin-bottom:.3em", title)
    return make_element("div", "max-width:62em;line-height:1.45;overflow-x:auto", first, *render_content(content))


def render_content(content: Iterable[object]) -> Iterator[Html]:
    """Render texts (small print), lists, tables and parts; `Html` stays unchanged."""
    for item in content:
        if isinstance(item, Html):
            yield item
        elif isinstance(item, TextTable):
            yield make_table(item)
        elif isinstance(item, Part) and item.brief:
            yield make_element("div", "font-weight:600;margin:.7em 0 .15em", item.title)
            yield from render_content(item.content)
        elif isinstance(item, Part):
            summary = make_element("summary", "cursor:pointer;margin:.5em 0 .2em", item.title)
            yield make_element("details", "", summary, *render_content(item.content))
        elif isinstance(item, tuple):
            points = [make_element("li", "margin:.1em 0", point) for point in item]
            yield make_element("ul", "margin:.2em 0;padding-left:1.3em", *points) if points else Html()
        elif item:
            yield make_element("div", f"margin:.15em 0;{SMALL}", item)


def make_table(content: TextTable) -> Html:
    """Make a table of texts; cells of block characters are coloured as bars."""
    is_left = [k == 0 or header in content.left for k, header in enumerate(content.headers)]

    def make_row(tag: str, style: str, cells: Sequence[str]) -> Html:
        return make_element("tr", "background:none", *(make_cell(tag, style, k, text) for k, text in enumerate(cells)))

    def make_cell(tag: str, style: str, place: int, text: str) -> Html:
        bar = f"color:{BLUE};letter-spacing:-.05em;" if text[:1] in ("█", *PARTS[1:]) else ""
        wrap = "normal" if tag == "th" or (place > 0 and is_left[place]) else "nowrap"
        layout = f"padding:.22em .75em .22em 0;vertical-align:top;{LINE};white-space:{wrap}"
        return make_element(tag, f"{layout};text-align:{'left' if is_left[place] else 'right'};{bar}{style}", text)

    # no line break within a unit
    headers = [re.sub(r"\[.*?\]", lambda unit: unit[0].replace(" ", "\xa0"), text) for text in content.headers]
    head = make_row("th", "font-weight:500;opacity:.75", headers)
    body = [make_row("td", "font-variant-numeric:tabular-nums", cells) for cells in content.rows]
    parts = make_element("thead", "", head), make_element("tbody", "", *body)
    return make_element("table", "border-collapse:collapse;border:0;margin:.3em 0;font-size:.92em", *parts)


class PlotCurve(NamedTuple):
    """Values (N,) and style of a curve."""

    values: Array
    color: str
    dashed: bool = False


def make_legend(entries: Iterable[tuple[str, PlotCurve]]) -> Html:
    """Make the legend of curves, each name in its colour."""
    line = "display:inline-block;width:1.6em;margin:0 .4em .25em 0;border-top:2px"
    keys = []
    for name, curve in entries:
        line_sample = make_element("span", f"{line} {'dashed' if curve.dashed else 'solid'} {curve.color}")
        keys.append(make_element("span", "margin-right:1.2em;white-space:nowrap", line_sample, name))
    return make_element("div", SMALL, *keys)


def make_plot(
    label: str,
    x: Array,
    curves: Sequence[PlotCurve],
    noise: Array | None = None,
    span: tuple[float, float] | None = None,
) -> Html:
    """Make a small plot of curves with its lowest and highest value in print.

    Args:
        label: plotted quantity and unit.
        x: abscissa, increasing (N,).
        curves: curves with values (N,).
        noise: half width of a band about zero (N,).
        span: lowest and highest plotted value; None: those of the curves.
    """
    values = np.concatenate([curve.values for curve in curves])
    low, high = span or (float(values.min()), float(values.max()))
    room = (high - low) or 1.0

    def make_path(x_values: Array, y_values: Array) -> str:
        x_places = WIDTH * (x_values - x[0]) / ((x[-1] - x[0]) or 1.0)
        down = np.clip(HEIGHT * (high - y_values) / room, -HEIGHT, 2 * HEIGHT)
        return "M" + "L".join(f"{a:.0f} {b:.1f}" for a, b in zip(x_places, down, strict=True))

    shapes = []
    if low < 0 < high:
        shapes.append(f'<path d="M0 {HEIGHT * high / room:.1f}H{WIDTH}" stroke="currentColor" stroke-opacity=".25"/>')
    if noise is not None:
        band = make_path(np.r_[x, x[::-1]], np.r_[noise, -noise[::-1]])
        shapes.append(f'<path d="{band}Z" fill="currentColor" fill-opacity=".18"/>')
    for curve in curves:
        indices = select_samples(curve.values, 480)
        dashes = ' stroke-dasharray="5 3"' if curve.dashed else ""
        line = f'd="{make_path(x[indices], curve.values[indices])}" stroke="{curve.color}"{dashes}'
        shapes.append(f'<path {line} fill="none" stroke-width="1.4" vector-effect="non-scaling-stroke"/>')
    drawing = Html(
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none" role="img" aria-label="{escape(label)}" '
        f'style="display:block;width:100%;height:{HEIGHT}px;overflow:hidden">{"".join(shapes)}</svg>'
    )
    limits = make_element("span", "white-space:nowrap;margin-left:1em", f"{low:.3g} to {high:.3g}")
    caption = make_element(
        "div", f"display:flex;justify-content:space-between;{SMALL}", make_element("span", "", label), limits
    )
    return make_element("div", "max-width:42em;margin:.35em 0", caption, drawing)
