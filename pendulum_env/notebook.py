"""Display of results in notebooks; the workbench registers the text of each type."""

from functools import singledispatch
from importlib import import_module
from typing import Any

BLUE, ORANGE, GREEN = "#3d85d8", "#d9792a", "#2f9e77"  # contrast of at least 3:1 on white and on black
NARRATOR = "workbench.narrator.notebook"  # imported at the first use


@singledispatch
def render_html(result: object) -> str:
    """Render a result as HTML by the function that is registered for its type."""
    return _narrate(render_html, result)


@singledispatch
def summarise(result: object) -> str:
    """Summarise a result in one sentence by the function that is registered for its type."""
    return _narrate(summarise, result)


def _narrate(generic: Any, result: object) -> str:
    """Import the narrator, which registers its functions, and call the one for the result's type."""
    import_module(NARRATOR)
    narrate = generic.dispatch(type(result))
    if narrate is generic.dispatch(object):
        raise TypeError(f"{type(result).__name__} has no text")
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
