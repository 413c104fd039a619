"""The type `Stage`, and components shared by the stages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dash import Dash, dcc, html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise, typeset
from pendulum_env.physics.effect_texts import name_effect
from pendulum_env.physics.joints import list_effects, place_effects
from pendulum_env.physics.mechanism import PENDULUM, Mechanism
from pendulum_env.physics.table import TABLES
from workbench.app.session import Session, Sessions
from workbench.narrator import parts as report
from workbench.report import page
from workbench.report.data import Section

Content = Component | str | Sequence[Component | str] | None

KEPT: dict[str, Any] = {"persistence": True, "persistence_type": "session"}  # keeps the input of a tab over a reload


Form = Mapping[str, Any]  # values of the page's controls by name
Action = Callable[[Session, str, Form], object]  # of session, object of the button, and form


@dataclass(frozen=True)
class Stage:
    """Stage of the workbench: its rendering, and the actions of its buttons."""

    id: str  # fragment of the page's address
    title: str  # in the navigation
    show: Callable[[Session], list[Component]]  # renders the stage; reads `session.state` once
    # Action of each button, by name
    actions: Mapping[str, Action] = field(default_factory=dict)
    # Renders each slow part of the page, by name; see `make_late`
    late: Mapping[str, Callable[[Session], Component | None]] = field(default_factory=dict)
    # Registers callbacks that leave the session unchanged
    connect: Callable[[Dash, Sessions], None] | None = None
    needs_model: bool = True  # whether the stage is empty without a fitted model


def typeset_texts(content: Any) -> Any:
    """Return components with their texts set for a page by `typeset`, other than code."""
    if isinstance(content, str):
        return typeset(content)
    if isinstance(content, list | tuple):
        return [typeset_texts(item) for item in content]
    if isinstance(content, Component) and not isinstance(content, html.Pre | html.Code):
        if (children := getattr(content, "children", None)) is not None:
            content.children = typeset_texts(children)
    return content


def make_aria(**attributes: str) -> dict[str, Any]:
    """Make attributes for screen readers: `label` becomes `aria-label`."""
    return {f"aria-{name}": value for name, value in attributes.items()}


def show_section(section: Section | None) -> list[Component]:
    """Render a section of the report; empty without one."""
    return show_content(section.content, section.id) if section is not None else []


def show_content(content: report.Content, id: str) -> list[Component]:
    """Render content of a report, drawn by scripts of the page; `id`: unique on the page."""
    markup = dcc.Store(id={"kind": "markup", "of": id}, data=page.render_fragment(content))
    return [html.Div([markup, html.Div(id={"kind": "fragment", "of": id}, className="fragment")])]


def make_button(
    label: Content, action: str | dict[str, str], of: str = "", primary: bool = False, **attributes: Any
) -> Component:
    """Make a button for the action `action` on the object `of`; a dictionary `action` is the id itself."""
    id = {"do": action, "of": of} if isinstance(action, str) else action
    look = {"className": "action primary" if primary else "action", "n_clicks": 0}
    return html.Button(label, id=id, type="button", **(look | attributes))


def make_save_button(file: str, key: str, primary: bool = False) -> Component:
    """Make a button that saves a file; `key`: key of `downloads.FILES`."""
    return make_button(file, {"save": key}, primary=primary)


def list_choices(body: Mechanism = PENDULUM, tables: bool = False) -> dict[str, str]:
    """Return names of effects by id, for an arm at each joint; with `tables` also tables, else also all joints."""
    kinds = list_effects(body) | (TABLES if tables else {})
    ids = dict.fromkeys([*([] if tables else kinds), *(kind.id for kind in place_effects(kinds.values(), body))])
    return {id: capitalise(name_effect(id)) for id in ids}


def label_control(label: str, control: Component, note: str = "") -> Component:
    """Make a labelled control, perhaps with a note."""
    return html.Label([html.Span(label), control, *([html.Small(note)] if note else [])], className="field")


def make_panel(title: str, *content: Component | str, className: str = "") -> Component:
    """Make a framed section with a heading."""
    return html.Section([html.H2(title), *content], className=f"panel {className}".strip())


def make_late(name: str, placeholder: Component | None = None) -> Component:
    """Make an element that is filled by a function of `Stage.late` once the rest of the page is drawn."""
    return html.Div(placeholder, id={"late": name})


def make_table(headers: Mapping[str, str], rows: Sequence[Sequence[Any]], label: str) -> Component:
    """Make a scrollable table; `headers` maps each title to the class of its column.

    `number` aligns a column to the right; `small`, `medium` and `wide` hide it in narrower windows.
    """
    head = html.Tr([html.Th(name, scope="col", className=kind) for name, kind in headers.items()])
    body = [
        html.Tr([html.Td(x, className=kind) for x, kind in zip(row, headers.values(), strict=True)]) for row in rows
    ]
    return html.Div(
        html.Table([html.Thead(head), html.Tbody(body)]),
        className="scroll",
        tabIndex=0,
        role="region",
        **make_aria(label=label),
    )
