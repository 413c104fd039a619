"""Model: its terms, parameters with their uncertainty, and the six schemes side by side."""

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise
from workbench.app.parts import make_button, make_drop_area, make_fragment, make_graph, make_panel, make_table
from workbench.app.session import Session, Stage
from workbench.app.state import State as Work
from workbench.app.uploads import unpack
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
        show_start(state),
    ]


def _show_schemes(state: Work) -> list[Component]:
    """Show the estimates of each scheme: known ones as a table, others as the section of the report."""
    if state.prepared.schemes is not None:
        found = tabulate_schemes(state.prepared.schemes)
        headers = {
            capitalise(name_effect(text)): k > 0 and text not in found.left for k, text in enumerate(found.headers)
        }
        return [make_table(headers, found.rows, "Schemes"), html.P(f"{capitalise(TRUST)}.")]
    section = make_schemes(state.standing)
    if section is None:
        return [html.P("These recordings are too poor for the schemes.")]
    plots = [make_graph(figure) for figure in section.figures]
    return [make_fragment(section), html.Div(plots, className="grid")]


def show_start(state: Work) -> Component:
    """Show the choice of another model to start from."""
    usual = "the paper's four terms" if state.robot is None else "friction at each joint"
    said = f"the terms of {state.model_file}" if state.model_file else usual
    return make_panel(
        "Start from another model",
        html.P(f"The base model has {said}. Another one is fitted to the same recordings; what was added is left out."),
        make_drop_area(
            [html.Strong("Choose a model"), ", a JSON file that identify, diagnose or add wrote"], "model-file"
        ),
        make_button(f"Back to {usual}", "model-back", disabled=not state.model_file),
    )


STAGE = Stage(
    "model",
    "Model",
    show,
    {
        "model-file": lambda session, _, came: session.begin_from(unpack(session.place(), *came["files"][0])),
        "model-back": lambda session, *_: session.change(
            "start from the usual terms", session.state.restart(terms=(), model_file="")
        ),
    },
)
