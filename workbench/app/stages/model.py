"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise
from workbench.app.parts import make_fragment, make_graph, make_panel, make_table
from workbench.app.session import Session, Stage
from workbench.app.state import State as Work
from workbench.narrator.effects import name_effect
from workbench.narrator.identification import TRUST, tabulate_schemes
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
        make_panel("Parameters with standard errors", make_fragment(make_parameters(state.standing))),
        make_panel("Schemes side by side", *_show_schemes(state)),
    ]


def _show_schemes(state: Work) -> list[Component]:
    """Show the estimates of each scheme: known ones as a table, others as the section of the report."""
    if state.schemes is not None and not state.body.can_simulate:
        found = tabulate_schemes(state.schemes)
        headers = {
            capitalise(name_effect(text)): k > 0 and text not in found.left for k, text in enumerate(found.headers)
        }
        return [make_table(headers, found.rows, "Schemes"), html.P(f"{capitalise(TRUST)}.")]
    section = make_schemes(state.standing) if state.schemes is not None else None
    if section is None:
        return [html.P("These recordings are too poor for the schemes.")]
    plots = [make_graph(figure) for figure in section.figures]
    return [make_fragment(section), html.Div(plots, className="grid")]


STAGE = Stage("model", "Model", show)
