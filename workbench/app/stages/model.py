"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from __future__ import annotations

from dash import Input, State, dcc, html
from dash.development.base_component import Component

from workbench.app.parts import button, fragment, graph, panel
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.app.state import State as Work
from workbench.app.uploads import UPLOAD
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
    return [*parts, _start(state)]


def _start(state: Work) -> Component:
    """Another model to start from."""
    said = f"the terms of {state.model_file}" if state.model_file else "the paper's four terms"
    upload = dcc.Upload(
        [html.Strong("Choose a model"), ", a JSON file that identify, diagnose or add wrote"],
        id="model-file",
        max_size=UPLOAD,
        className="drop",
        className_active="drop over",
        style={},
    )
    back = button("Back to the paper's four", "model-back", disabled=not state.model_file)
    return panel(
        "Start from another model",
        html.P(f"The base model has {said}. Another one is fitted to the same recordings; what was added is left out."),
        upload,
        back,
    )


def connect(bench: Bench) -> None:
    """Wire the choice of the base model."""

    @bench.on(Input("model-file", "contents"), given=(State("model-file", "filename"),))
    def begin(session: Session, content: str, file: str) -> None:
        session.begin_from(file, content)

    @bench.on(Input("model-back", "n_clicks"))
    def back(session: Session, _: int) -> None:
        session.state = session.state.fitting()


STAGE = Stage("model", "Model", show, connect)
