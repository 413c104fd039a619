"""How results show themselves in a notebook: the narrator of the workbench registers what to show."""

from functools import singledispatch
from importlib import import_module

BLUE, ORANGE, GREEN = "#3d85d8", "#d9792a", "#2f9e77"  # 3 : 1 or more on white and on black
NARRATOR = "workbench.narrator.notebook"  # loaded, by name, when first needed


@singledispatch
def render_html(result: object) -> str:
    """Render a result as HTML; each kind of result is registered by the code that shows it."""
    import_module(NARRATOR)
    show = render_html.dispatch(type(result))
    if show is render_html.dispatch(object):
        raise TypeError(f"{type(result).__name__} has no HTML form")
    return show(result)


@singledispatch
def summarise(result: object) -> str:
    """Summarise a result in one sentence; registered as `render_html`."""
    import_module(NARRATOR)
    narrate = summarise.dispatch(type(result))
    if narrate is summarise.dispatch(object):
        raise TypeError(f"there is no headline of a {type(result).__name__}")
    return narrate(result)
