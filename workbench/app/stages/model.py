"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from __future__ import annotations

from dash import html
from dash.development.base_component import Component

from pendulum_env.words import name, opening
from workbench.app.parts import button, drop, fragment, graph, panel
from workbench.app.session import Session
from workbench.app.stage import Stage
from workbench.app.state import State as Work
from workbench.report.sections.parameters import parameters
from workbench.report.sections.schemes import schemes


def show(session: Session) -> list[Component]:
    """Terms, parameters, schemes."""
    state = session.state
    terms = [
        html.Li([html.Strong(opening(name(term.id))), " ", html.Span(term.law, className="law")])
        for term in state.model.terms
    ]
    about = html.P("The torque that moves the joint is the sum of these terms:")
    section = schemes(state.standing)
    side_by_side: list[Component] = [html.P("These recordings are too poor for the six schemes.")]
    if section is not None:
        plots = [graph(figure) for figure in section.content["figures"]]
        side_by_side = [fragment(section), html.Div(plots, className="grid")]
    return [
        panel("The model", about, html.Ul(terms, className="terms")),
        panel("Parameters and how sure they are", fragment(parameters(state.standing))),
        panel("The six schemes side by side", *side_by_side),
        begin_anew(state),
    ]


def begin_anew(state: Work) -> Component:
    """Another model to start from."""
    usual = "the paper's four terms" if type(state).terms else "friction at each joint"
    said = f"the terms of {state.model_file}" if state.model_file else usual
    return panel(
        "Start from another model",
        html.P(f"The base model has {said}. Another one is fitted to the same recordings; what was added is left out."),
        drop([html.Strong("Choose a model"), ", a JSON file that identify, diagnose or add wrote"], "model-file"),
        button(f"Back to {usual}", "model-back", disabled=not state.model_file),
    )


def _back(session: Session) -> None:
    session.change("start from the usual terms", session.state.anew(terms=type(session.state).terms, model_file=""))


STAGE = Stage(
    "model",
    "Model",
    show,
    {
        "model-file": lambda session, _, came: session.begin_from(*came["files"][0]),
        "model-back": lambda session, *_: _back(session),
    },
)
