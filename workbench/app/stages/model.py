"""Two stages: Model with terms, parameters and schemes, and Compare with residuals and simulations."""

from functools import lru_cache

from dash import html
from dash.development.base_component import Component

from estimators.data.matches import find_matches
from estimators.data.regions import compute_profiles_at
from estimators.signals.residual import AXES, find_regions
from pendulum_env.formatting import TextTable
from workbench.app.parts import Stage, make_button, make_late, make_panel, show_content, show_section
from workbench.app.session import Session
from workbench.app.state import State
from workbench.narrator.identification import TRUST, tabulate_schemes
from workbench.report.comparison import make_comparison
from workbench.report.data import Section
from workbench.report.failures import make_failures
from workbench.report.matches import describe_match, name_match, plot_matches
from workbench.report.numbers import COLORS, make_parameters, make_schemes

SCHEMES = "Schemes side by side"  # title of a panel


def show_model(session: Session) -> list[Component]:
    """Render the terms, the parameters with standard errors, and the schemes."""
    state = session.state
    terms = TextTable(("effect", "law"), [(term.id, term.law) for term in state.model.terms], left=("law",))
    about = "The torque that moves a joint is the sum of these terms:"
    return [
        make_panel("The model", *show_content([about, terms], "terms")),
        make_panel("Parameters with standard errors", *show_section(make_parameters(state.report_data))),
        make_late("schemes", make_panel(SCHEMES, html.P("Each scheme is fitted …"))),
    ]


def show_schemes(session: Session) -> Component:
    """Render the estimates of each scheme; for an arm without their convergence."""
    state = session.state
    if state.fit is not None and state.fit.schemes is not None:
        section: Section | None = Section("schemes", "", SCHEMES, [tabulate_schemes(state.fit.schemes), f"{TRUST}."])
    else:
        section = make_schemes(state.report_data)
    return make_panel(SCHEMES, *(show_section(section) or [html.P("These recordings are too poor for the schemes.")]))


def show_comparison(session: Session) -> list[Component]:
    """Render the residuals of the base and the last model, similar effects, and motion over time."""
    failures, comparison = (make_panel(s.title, *show_section(s)) for s in _make_sections(session.state))
    similar = make_panel("What it looks like", html.P("Every effect of the library is fitted to the residual …"))
    return [failures, make_late("similar", similar), comparison]


@lru_cache(maxsize=4)  # slow to draw
def _make_sections(state: State) -> tuple[Section, ...]:
    return make_failures(state.report_data), make_comparison(state.report_data)


def show_matches(session: Session) -> Component:
    """Render the residual of the last model over four quantities, with the torque of the best matches.

    Of an arm, the joint with the largest residual relative to its noise floor is shown.
    """
    case, is_busy = session.state.report_data, session.is_busy()
    data, model, residual = case.parts[0][-1], case.diagnosis.model, case.compute_residuals(0)[-1]
    errors = data.layout.compute_joint_errors(residual)
    at = max(errors, key=lambda joint: errors[joint] / data.floors[joint])
    title = f"What it looks like at {at}" if at else "What it looks like"
    if not find_regions(compute_profiles_at(data, residual, at)):
        return make_panel(title, html.P("The residual is within the noise: it looks like no effect."))
    matches = find_matches(data, model, at=at)[: len(COLORS)]
    about = (
        "Dots: the residual of the last model. Curves: the three effects that explain most of its mean square, each "
        "fitted to the same data beside the terms of the model. Only the diagnosis checks them on other data."
    )
    rows = [
        html.Li(
            [
                html.I(className="stroke", style={"--color": f"var({color})"}),
                html.Strong(name_match(match)),
                make_button("Try it", "add", match.effect, disabled=is_busy),
                html.Small(describe_match(match)),
            ]
        )
        for match, color in zip(matches, COLORS, strict=False)
    ]
    plots = show_content([about, tuple(plot_matches(data, residual, matches, (*AXES,), "match", at))], "matches")
    return make_panel(title, *plots, html.Ul(rows, className="matches"))


MODEL = Stage("model", "Model", show_model, late={"schemes": show_schemes})
COMPARE = Stage("compare", "Compare", show_comparison, late={"similar": show_matches})
