"""Stages, and the parts that they are made of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dash import Dash, dcc, html
from dash.development.base_component import Component

from pendulum_env.arms.joints import list_effects, place_effects
from pendulum_env.formatting import capitalise
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.physics.table import TABLES
from workbench.app.session import Session, Sessions
from workbench.figure import Figure
from workbench.narrator import parts as report
from workbench.narrator.effects import name_effect
from workbench.narrator.parts import list_figures
from workbench.report import page
from workbench.report.data import Section

Content = Component | str | Sequence[Component | str] | None

PLOT, SPEC = "plot", "spec"  # a graph, and its figure
UNWRAP = "unwrap: undo jumps of 2π in position"
BUTTONS = ["zoom2d", "pan2d", "resetScale2d", "toImage"]  # by name, so that none that sends data elsewhere slips in
CLEAR = "rgba(0,0,0,0)"
HIDDEN = {"visible": False}
EMPTY = {"layout": {"xaxis": HIDDEN, "yaxis": HIDDEN, "paper_bgcolor": CLEAR, "plot_bgcolor": CLEAR}}
KEPT: dict[str, Any] = {"persistence": True, "persistence_type": "session"}  # what a tab has entered, over a reload


Form = Mapping[str, Any]  # values of the controls on the page, or what files came, by name
Action = Callable[[Session, str, Form], object]  # told what the button is of


@dataclass(frozen=True)
class Stage:
    """A stage of the workbench: a function that draws it from a session, and what its buttons do."""

    id: str  # of the page's address, `#id`
    title: str  # in the navigation
    show: Callable[[Session], list[Component]]  # what it looks like now; it reads the session's state once
    # What its buttons and files do, by the name that the button has
    actions: Mapping[str, Action] = field(default_factory=dict)
    # Registers callbacks that do nothing to the session, if it has some
    connect: Callable[[Dash, Sessions], None] | None = None
    needs_model: bool = True  # whether there is nothing to see before a model is fitted


def make_graph(figure: Figure) -> Component:
    """Make a figure of the report with a bar of buttons; the page fills in its colours, in light and dark."""
    config: Any = {"displaylogo": False, "modeBarButtons": [BUTTONS]}
    style, id = {"height": figure.height}, {"kind": PLOT, "of": figure.id}
    spec = {"data": figure.data, "layout": figure.layout}  # what the page needs to draw it
    drawn = dcc.Graph(id=id, figure=EMPTY, responsive=True, config=config, style=style)
    plot = html.Div(drawn, role="group", className="plot", style=style, **make_aria(label=figure.label))
    return html.Figure([dcc.Store(id={"kind": f"{PLOT}-{SPEC}", "of": figure.id}, data=spec), plot])


def make_aria(**attributes: str) -> dict[str, Any]:
    """Make the attributes for those who cannot see the page: `label` becomes `aria-label`."""
    return {f"aria-{name}": value for name, value in attributes.items()}


def show_section(section: Section) -> list[Component]:
    """Show a section of the report: text and tables as the report has them, figures as graphs."""
    return show_content(section.content, section.id)


def show_content(content: report.Content, id: str) -> list[Component]:
    """Show some content; `id` is unique on the page."""
    shown: list[Component] = []
    for number, item in enumerate(content):
        of, figures = f"{id}-{number}", list(list_figures([item]))
        if not figures:
            text = dcc.Store(id={"kind": "markup", "of": of}, data=page.render_fragment([item]))
            shown.append(html.Div([text, html.Div(id={"kind": "fragment", "of": of}, className="fragment")]))
        elif isinstance(item, report.Part):
            inner = show_content(item.content, of)
            title = capitalise(item.title)
            shown += [html.H3(title), *inner] if item.brief else [html.Details([html.Summary(title), *inner])]
        else:
            shown.append(html.Div([make_graph(figure) for figure in figures], className="grid"))
    return shown


def make_button(
    label: Content, does: str | dict[str, str], of: str = "", primary: bool = False, **more: Any
) -> Component:
    """Make a button for an action on an object, or with another id."""
    id = {"do": does, "of": of} if isinstance(does, str) else does
    look = {"className": "action primary" if primary else "action", "n_clicks": 0}
    return html.Button(label, id=id, type="button", **(look | more))


def make_save_button(file: str, what: str, primary: bool = False) -> Component:
    """Make a button that saves a file; `what` is one of `export.FILES`."""
    return make_button(file, {"save": what}, primary=primary)


def list_choices(body: Mechanism = PENDULUM, tables: bool = False) -> dict[str, str]:
    """List names of effects by id, perhaps with tables; of an arm at single joints and at every joint."""
    kinds = list_effects(body) | (TABLES if tables else {})
    ids = dict.fromkeys([*([] if tables else kinds), *(kind.id for kind in place_effects(kinds.values(), body))])
    return {id: capitalise(name_effect(id)) for id in ids}


def label_control(label: str, control: Component, note: str = "") -> Component:
    """Label a control, perhaps with a note."""
    return html.Label([html.Span(label), control, *([html.Small(note)] if note else [])], className="field")


def make_panel(title: str, *content: Component | str, className: str = "") -> Component:
    """Make a framed part with a heading."""
    return html.Section([html.H2(title), *content], className=f"panel {className}".strip())


def make_table(headers: Mapping[str, bool], rows: Sequence[Sequence[Any]], label: str) -> Component:
    """Make a table; each header tells whether its column holds numbers. A wide table scrolls by keyboard, too."""
    of = ["number" if number else None for number in headers.values()]
    head = html.Tr([html.Th(name, scope="col", className=kind) for name, kind in zip(headers, of, strict=True)])
    body = [html.Tr([html.Td(x, className=kind) for x, kind in zip(row, of, strict=True)]) for row in rows]
    return html.Div(
        html.Table([html.Thead(head), html.Tbody(body)]),
        className="scroll",
        tabIndex=0,
        role="region",
        **make_aria(label=label),
    )
