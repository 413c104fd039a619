"""Putting the page together: sections, style, script and plotly.js in one file."""

import base64
import gzip
from collections.abc import Sequence
from datetime import datetime
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs, get_plotlyjs_version

from pendulum_env.formatting import capitalise, format_number, format_unit, join_words, typeset
from workbench.narrator.effects import name_effect
from workbench.narrator.parts import Content
from workbench.report.data import Section


@cache
def _load_environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("workbench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    functions = (capitalise, join_words, format_number, format_unit, typeset, name_effect)
    environment.filters |= {function.__name__: function for function in functions}
    return environment


@cache
def pack_plotly() -> str:
    """Pack plotly.js: a third of the size, and browsers unpack it in a few hundredths of a second."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()


def render_fragment(content: Content) -> str:
    """Render some content of a section, for another page in the same style."""
    return _load_environment().get_template("section.html").render(content=content)


def read_shared(name: str) -> str:
    """Read the style or script that all pages have: `style.css`, `theme.js`, `plot.js`."""
    return _load_environment().get_template(name).render()


def render_page(sections: Sequence[Section], subject: str) -> str:
    """Render a page from its sections; the first title is that of the page, `subject` stands above it."""
    return (
        _load_environment()
        .get_template("page.html")
        .render(
            sections=sections,
            title=sections[0].title,
            subject=subject,
            written=f"{datetime.now().astimezone():%d %B %Y, %H:%M}",
            plotly=pack_plotly(),
            plotly_version=get_plotlyjs_version(),
        )
    )
