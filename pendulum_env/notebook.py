"""How results show themselves in a notebook: the narrator of the workbench registers what to show."""

from functools import singledispatch
from importlib import import_module
from typing import Any

BLUE, ORANGE, GREEN = "#3d85d8", "#d9792a", "#2f9e77"  # 3 : 1 or more on white and on black
NARRATOR = "workbench.narrator.notebook"  # loaded, by name, when first needed


@singledispatch
def render_html(result: object) -> str:
    """Render a result as HTML; each kind of result is registered by the code that shows it."""
    return _narrate(render_html, result)


@singledispatch
def summarise(result: object) -> str:
    """Summarise a result in one sentence; registered as `render_html`."""
    return _narrate(summarise, result)


def _narrate(generic: Any, result: object) -> str:
    """Return the text of a result by the function that the narrator registers for its kind."""
    import_module(NARRATOR)
    narrate = generic.dispatch(type(result))
    if narrate is generic.dispatch(object):
        raise TypeError(f"{type(result).__name__} has no text")
    text: str = narrate(result)
    return text


class Shown:
    """Result that a notebook shows as `render_html` renders it."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return render_html(self)
