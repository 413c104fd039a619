"""Compare: measured against modelled, and where the model fails."""

from functools import lru_cache
from pathlib import Path

from dash import html
from dash.development.base_component import Component

from workbench.app.parts import list_choices, make_panel, show_section
from workbench.app.session import Session
from workbench.app.sessions import Stage
from workbench.app.state import State
from workbench.narrator.effects import find_description
from workbench.report.arm import make_strips
from workbench.report.comparison import make_comparison
from workbench.report.data import Section, list_ends
from workbench.report.failures import make_failures

GALLERY = Path(__file__).parents[1] / "assets" / "gallery"  # `make pages` draws it


def show(session: Session) -> list[Component]:
    """Show where the base model and the last one fail, and measured against modelled motion."""
    state = session.state
    shown = [make_panel(section.title, *show_section(section)) for section in _make_sections(state)]
    return [*shown, _show_gallery(state)] if state.robot is None else shown


@lru_cache(maxsize=4)  # while the page shows one
def _make_sections(state: State) -> tuple[Section, ...]:
    if state.robot is not None:
        return (make_strips(list_ends(state.ladder), state.data.parts[0]),)
    return make_failures(state.standing), make_comparison(state.standing)


def _show_gallery(state: State) -> Component:
    """Show the residuals that single effects leave, the likeliest first after a diagnosis."""
    names = list_choices()
    found = [one.effect for one in state.diagnosis.candidates] if state.diagnosis is not None else []
    rows = []
    for id in sorted(names, key=lambda id: found.index(id) if id in found else len(found)):
        if (GALLERY / f"{id}.svg").is_file():
            leaves = html.Img(src=f"/assets/{GALLERY.name}/{id}.svg", alt=f"What {names[id]} leaves")
            note = html.P(find_description(id).signature, className="note")
            rows.append(html.Li([names[id], html.Div([leaves, note])]))
    about = "The residual of each effect in the paper's pendulum. Signs and sizes may differ."
    summary = html.Summary("Effects to compare it with")
    listed = html.Details([summary, html.Ul(rows)])
    return make_panel("What it looks like", html.P(about, className="note"), listed, className="gallery")


STAGE = Stage("compare", "Compare", show)
