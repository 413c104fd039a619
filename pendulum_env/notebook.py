"""Texts of results and their display in notebooks, registered by the modules of the entry points `NARRATORS`."""

from functools import singledispatch
from typing import Any

from pendulum_env.plugins import load_plugins

BLUE, ORANGE, GREEN = "#3d85d8", "#d9792a", "#2f9e77"  # contrast of at least 3:1 on white and on black
NARRATORS = "pendulum_ident.narrators"  # loaded at the first use; the workbench has one


@singledispatch
def render_html(result: object) -> str:
    """Render a result as HTML by the function that is registered for its type."""
    return _narrate(render_html, result)


@singledispatch
def summarise(result: object) -> str:
    """Summarise a result in one sentence by the function that is registered for its type."""
    return _narrate(summarise, result)


@singledispatch
def render_text(result: object) -> str:
    """Render a result as the text that the command line prints, by the function that is registered for its type."""
    return _narrate(render_text, result)


def _narrate(generic: Any, result: object) -> str:
    """Load the installed narrators, which register their functions, and call the one for the result's type."""
    load_plugins(NARRATORS)
    narrate = generic.dispatch(type(result))
    if narrate is generic.dispatch(object):
        raise TypeError(f"{type(result).__name__} has no text: install pendulum-ident again to register its narrator")
    text: str = narrate(result)
    return text


class Shown:
    """Mixin of results that a notebook displays by `render_html`."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return render_html(self)


class Summarised(Shown):
    """Mixin of results with a sentence of their own, by `summarise`."""

    __slots__ = ()

    @property
    def headline(self) -> str:
        """Result in one sentence: `Stribeck friction is missing`."""
        return summarise(self)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline}>"

    def __str__(self) -> str:
        return render_text(self)
