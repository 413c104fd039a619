"""Two stages: Model with terms, parameters and schemes, and Compare with residuals and simulations."""

from functools import lru_cache
from pathlib import Path

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise
from pendulum_env.physics.effect_texts import find_description, name_effect
from workbench.app.parts import Stage, list_choices, make_panel, show_section
from workbench.app.session import Session
from workbench.app.state import State
from workbench.narrator.identification import TRUST, tabulate_schemes
from workbench.report.comparison import make_comparison
from workbench.report.data import Section
from workbench.report.failures import make_failures
from workbench.report.numbers import make_parameters, make_schemes

GALLERY = Path(__file__).parents[1] / "assets" / "gallery"  # drawn by `make pages`


def show_model(session: Session) -> list[Component]:
    """Render the terms, the parameters with standard errors, and the schemes."""
    state = session.state
    terms = [
        html.Li([html.Strong(capitalise(name_effect(term.id))), " ", html.Span(term.law, className="law")])
        for term in state.model.terms
    ]
    about = html.P("The torque that moves a joint is the sum of these terms:")
    return [
        make_panel("The model", about, html.Ul(terms, className="terms")),
        make_panel("Parameters with standard errors", *show_section(make_parameters(state.report_data))),
        make_panel("Schemes side by side", *_show_schemes(state)),
    ]


def _show_schemes(state: State) -> list[Component]:
    """Render the estimates of each scheme; for an arm without their convergence."""
    if state.schemes is not None and not state.body.can_simulate:
        return show_section(Section("schemes", "Schemes", "Schemes", [tabulate_schemes(state.schemes), f"{TRUST}."]))
    section = make_schemes(state.report_data) if state.schemes is not None else None
    return show_section(section) if section is not None else [html.P("These recordings are too poor for the schemes.")]


def show_comparison(session: Session) -> list[Component]:
    """Render the residuals of the base and the last model, and measured and modelled motion over time."""
    state = session.state
    panels = [make_panel(section.title, *show_section(section)) for section in _make_sections(state)]
    return [*panels, _show_gallery(state)] if state.robot is None else panels


@lru_cache(maxsize=4)  # slow to draw
def _make_sections(state: State) -> tuple[Section, ...]:
    return make_failures(state.report_data), make_comparison(state.report_data)


def _show_gallery(state: State) -> Component:
    """Render pictures of the residual of each effect, in the order of the diagnosis, if one was made."""
    names = list_choices()
    effects = [candidate.effect for candidate in state.diagnosis.candidates] if state.diagnosis is not None else []
    rows = []
    for id in sorted(names, key=lambda id: effects.index(id) if id in effects else len(effects)):
        if (GALLERY / f"{id}.svg").is_file():
            leaves = html.Img(src=f"/assets/{GALLERY.name}/{id}.svg", alt=f"What {names[id]} leaves")
            note = html.P(find_description(id).signature, className="note")
            rows.append(html.Li([names[id], html.Div([leaves, note])]))
    about = "The residual of each effect in the paper's pendulum. Signs and sizes may differ."
    summary = html.Summary("Effects to compare it with")
    gallery = html.Details([summary, html.Ul(rows)])
    return make_panel("What it looks like", html.P(about, className="note"), gallery, className="gallery")


MODEL = Stage("model", "Model", show_model)
COMPARE = Stage("compare", "Compare", show_comparison)
