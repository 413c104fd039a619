"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise
from workbench.app.parts import button, drop, fragment, graph, panel, table
from workbench.app.session import Session, Stage
from workbench.app.state import State as Work
from workbench.app.uploads import unpack
from workbench.narrator.effects import name
from workbench.narrator.results import TRUST, schemes_table
from workbench.report.numbers import parameters, schemes


def show(session: Session) -> list[Component]:
    """Terms, parameters, schemes."""
    state = session.state
    terms = [
        html.Li([html.Strong(capitalise(name(term.id))), " ", html.Span(term.law, className="law")])
        for term in state.model.terms
    ]
    about = html.P("The torque that moves a joint is the sum of these terms:")
    return [
        panel("The model", about, html.Ul(terms, className="terms")),
        panel("Parameters and how sure they are", fragment(parameters(state.standing))),
        panel("Schemes side by side", *_schemes(state)),
        begin_anew(state),
    ]


def _schemes(state: Work) -> list[Component]:
    """Estimates by each scheme: a table of those that have been found already, or else the section of the report."""
    if state.prepared.schemes is not None:
        found = schemes_table(state.prepared.schemes)
        headers = {capitalise(name(text)): k > 0 and text not in found.left for k, text in enumerate(found.headers)}
        return [table(headers, found.rows, "Schemes"), html.P(f"{capitalise(TRUST)}.")]
    section = schemes(state.standing)
    if section is None:
        return [html.P("These recordings are too poor for the schemes.")]
    plots = [graph(figure) for figure in section.content["figures"]]
    return [fragment(section), html.Div(plots, className="grid")]


def begin_anew(state: Work) -> Component:
    """Another model to start from."""
    usual = "the paper's four terms" if state.robot is None else "friction at each joint"
    said = f"the terms of {state.model_file}" if state.model_file else usual
    return panel(
        "Start from another model",
        html.P(f"The base model has {said}. Another one is fitted to the same recordings; what was added is left out."),
        drop([html.Strong("Choose a model"), ", a JSON file that identify, diagnose or add wrote"], "model-file"),
        button(f"Back to {usual}", "model-back", disabled=not state.model_file),
    )


STAGE = Stage(
    "model",
    "Model",
    show,
    {
        "model-file": lambda session, _, came: session.begin_from(unpack(session.place(), *came["files"][0])),
        "model-back": lambda session, *_: session.change(
            "start from the usual terms", session.state.anew(terms=(), model_file="")
        ),
    },
)
