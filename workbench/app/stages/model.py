"""Two stages: Model with terms, parameters and schemes, and Compare with residuals and simulations."""

from functools import lru_cache

from dash import Dash, Input, Output, html
from dash import State as Value
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from pendulum_env.formatting import TextTable
from workbench.app.matches import show_matches
from workbench.app.parts import Stage, make_panel, show_content, show_section, typeset_texts
from workbench.app.session import Session, Sessions
from workbench.app.state import State
from workbench.narrator.identification import TRUST, tabulate_schemes
from workbench.report.comparison import make_comparison
from workbench.report.data import Section
from workbench.report.failures import make_failures
from workbench.report.numbers import make_parameters, make_schemes

SIMILAR = "similar"  # id of the panel of effects like the residual


def show_model(session: Session) -> list[Component]:
    """Render the terms, the parameters with standard errors, and the schemes."""
    state = session.state
    terms = TextTable(("effect", "law"), [(term.id, term.law) for term in state.model.terms], left=("law",))
    about = "The torque that moves a joint is the sum of these terms:"
    return [
        make_panel("The model", *show_content([about, terms], "terms")),
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
    """Render the residuals of the base and the last model, motion over time, and for a pendulum similar effects."""
    state = session.state
    failures, comparison = (make_panel(s.title, *show_section(s)) for s in _make_sections(state))
    similar = make_panel("What it looks like", html.P("Every effect of the library is fitted to the residual …"))
    return [failures, *([html.Div(similar, id=SIMILAR)] if state.robot is None else []), comparison]


@lru_cache(maxsize=4)  # slow to draw
def _make_sections(state: State) -> tuple[Section, ...]:
    return make_failures(state.report_data), make_comparison(state.report_data)


def connect(app: Dash, sessions: Sessions) -> None:
    """Register the callback that fits similar effects once the rest of the page is drawn."""

    @app.callback(Output(SIMILAR, "children"), Input(SIMILAR, "id"), Value("session", "data"))
    def fit_similar_effects(_: str, id: str) -> Component:
        session = sessions.find_session(id)
        if session.state.failure_reason:
            raise PreventUpdate
        return typeset_texts(show_matches(session.state.report_data, session.is_busy()))


MODEL = Stage("model", "Model", show_model)
COMPARE = Stage("compare", "Compare", show_comparison, connect=connect)
