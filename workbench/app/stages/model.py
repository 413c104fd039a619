"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from __future__ import annotations

from dash import html
from dash.development.base_component import Component

from workbench.app.parts import fragment, graph, panel
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.report.sections.parameters import parameters
from workbench.report.sections.schemes import schemes
from workbench.report.words import name, opening


def show(session: Session) -> list[Component]:
    """Terms, parameters, schemes."""
    state = session.state
    terms = [
        html.Li([html.Strong(opening(name(term.id))), " ", html.Span(term.law, className="law")])
        for term in state.model.terms
    ]
    parts: list[Component] = [
        panel(
            "The model",
            html.P(["The torque that moves the joint is the sum of these terms:"]),
            html.Ul(terms, className="terms"),
        ),
        panel("Parameters and how sure they are", fragment(parameters(state.standing))),
    ]
    section = schemes(state.scheming)
    if section is None:
        parts.append(panel("The six schemes", html.P("These recordings are too poor for the six schemes.")))
    else:
        plots = html.Div([graph(figure) for figure in section.content["figures"]], className="grid")
        parts.append(panel("The six schemes side by side", fragment(section), plots))
    return parts


def connect(bench: Bench) -> None:
    """Nothing to click here."""


STAGE = Stage("model", "Model", show, connect)
