"""HTML page from sections, style, scripts and plotly.js."""

import base64
import gzip
from collections.abc import Sequence
from datetime import datetime
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs, get_plotlyjs_version

from pendulum_env.formatting import capitalise, format_number, format_unit, typeset
from pendulum_env.mathml import format_law
from pendulum_env.physics.effect_texts import name_effect, name_effects, name_parameter
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
        finalize=lambda value: typeset(value) if type(value) is str else value,  # neither markup nor code
    )
    functions = (capitalise, format_number, format_unit, name_effect, name_effects, name_parameter)
    environment.filters |= {function.__name__: function for function in functions}
    environment.filters["format_law"] = lambda law: Markup(format_law(law))
    return environment


@cache
def pack_plotly() -> str:
    """Return plotly.js, compressed by gzip and in base64, a third of its size."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 9, mtime=0)).decode()


def render_fragment(content: Content) -> str:
    """Render content of a section without a page."""
    return _load_environment().get_template("section.html").render(content=content)


def read_shared(name: str) -> str:
    """Read a file of the pages: `style.css`, or `app.html`, the page of the app."""
    return _load_environment().get_template(name).render()


def render_page(sections: Sequence[Section], subject: str) -> str:
    """Render a page from sections; its title is that of the first section, below `subject`."""
    return (
        _load_environment()
        .get_template("page.html")
        .render(
            sections=sections,
            title=sections[0].title,
            subject=subject,
            written=f"{datetime.now().astimezone():%d %B %Y, %H:%M}",
            plotly=Markup(pack_plotly()),
            plotly_version=get_plotlyjs_version(),
        )
    )
