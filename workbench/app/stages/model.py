"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise
from workbench.app.parts import make_panel, show_section
from workbench.app.session import Session
from workbench.app.sessions import Stage
from workbench.app.state import State as Work
from workbench.narrator.effects import name_effect
from workbench.narrator.identification import TRUST, tabulate_schemes
from workbench.report.data import Section
from workbench.report.numbers import make_parameters, make_schemes


def show(session: Session) -> list[Component]:
    """Show the terms, parameters, schemes."""
    state = session.state
    terms = [
        html.Li([html.Strong(capitalise(name_effect(term.id))), " ", html.Span(term.law, className="law")])
        for term in state.model.terms
    ]
    about = html.P("The torque that moves a joint is the sum of these terms:")
    return [
        make_panel("The model", about, html.Ul(terms, className="terms")),
        make_panel("Parameters with standard errors", *show_section(make_parameters(state.standing))),
        make_panel("Schemes side by side", *_show_schemes(state)),
    ]


def _show_schemes(state: Work) -> list[Component]:
    """Show the estimates of each scheme; of an arm without their convergence."""
    if state.schemes is not None and not state.body.can_simulate:
        return show_section(Section("schemes", "Schemes", "Schemes", [tabulate_schemes(state.schemes), f"{TRUST}."]))
    section = make_schemes(state.standing) if state.schemes is not None else None
    return show_section(section) if section is not None else [html.P("These recordings are too poor for the schemes.")]


STAGE = Stage("model", "Model", show)
