"""Parts of which the stages are built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dash import dcc, html
from dash.development.base_component import Component

from pendulum_env.physics import addable, effects
from pendulum_env.words import name, opening
from workbench.app.recorder import LONGEST, torques
from workbench.app.uploads import UPLOAD
from workbench.report import page
from workbench.report.figure import Figure, Section

Content = Component | str | Sequence[Component | str] | None

PLOT, LINKED, SPEC = "plot", "linked", "spec"  # a graph, one that selections light up in, and the figure of either
UNWRAP = "unwrap: undo jumps of 2π in position"
BUTTONS = ["zoom2d", "pan2d", "resetScale2d", "toImage"]  # by name, so that none that sends data elsewhere slips in
CLEAR = "rgba(0,0,0,0)"
HIDDEN = {"visible": False}
EMPTY = {"layout": {"xaxis": HIDDEN, "yaxis": HIDDEN, "paper_bgcolor": CLEAR, "plot_bgcolor": CLEAR}}
KEPT: dict[str, Any] = {"persistence": True, "persistence_type": "session"}  # what a tab has entered, over a reload


def graph(figure: Figure, caption: Content = None, kind: str = PLOT, bar: bool = True) -> Component:
    """A figure of the report, perhaps with a bar of buttons; the page fills in its colours, in light and dark."""
    buttons = [*BUTTONS[:2], "select2d", *BUTTONS[2:]] if figure.layout.get("dragmode") == "select" else BUTTONS
    return html.Figure(
        [
            *([html.Figcaption(caption)] if caption is not None else []),
            dcc.Store(id={"kind": f"{kind}-{SPEC}", "of": figure.id}, data=spec(figure)),
            html.Div(
                dcc.Graph(
                    id={"kind": kind, "of": figure.id},
                    figure=EMPTY,
                    responsive=True,
                    config={"displaylogo": False, "modeBarButtons": [buttons]} if bar else {"displayModeBar": False},
                    style={"height": figure.height},
                ),
                role="group",
                className="plot",
                style={"height": figure.height},
                **aria(label=figure.label),
            ),
        ]
    )


def aria(**attributes: str) -> dict[str, Any]:
    """Attributes for those who cannot see the page: `label` becomes `aria-label`."""
    return {f"aria-{name}": value for name, value in attributes.items()}


def spec(figure: Figure) -> dict[str, Any]:
    """What the page needs to draw a figure."""
    return {"data": figure.data, "layout": figure.layout}


def fragment(section: Section) -> Component:
    """Text and tables of a section of the report, in its own words; figures are left to `graph`."""
    return html.Div(
        [
            dcc.Store(id={"kind": "markup", "of": section.id}, data=page.fragment(section)),
            html.Div(id={"kind": "fragment", "of": section.id}, className="fragment"),
        ]
    )


def button(label: Content, id: Any, primary: bool = False, **more: Any) -> Component:
    """A button."""
    return html.Button(
        label, id=id, type="button", className="action primary" if primary else "action", **({"n_clicks": 0} | more)
    )


def saves(file: str, what: str, of: str = "", **more: Any) -> Component:
    """A button that saves a file; `what` is one of `export.FILES`."""
    return button(file, {"save": what, "of": of}, **more)


def effects_to_choose(nothing: str = "", tables: bool = False) -> dict[str, str]:
    """Names of all effects by id, and perhaps of none, and of tables."""
    return ({"": nothing} if nothing else {}) | {id: opening(name(id)) for id in (addable() if tables else effects())}


def dropdown(id: str, options: Mapping[str, str] | Sequence[Any], value: Any, **more: Any) -> Component:
    """A choice of one thing."""
    return dcc.Dropdown(options, value, id=id, clearable=False, **more)


def number_field(id: str, value: float | None, **more: Any) -> Component:
    """A field for a number, which a tab keeps."""
    return dcc.Input(value, type="number", id=id, **more, **KEPT)


def run_fields(prefix: str, seconds: float) -> list[Component]:
    """A form for a run of so many seconds: its torque, and what is hidden in the plant."""
    hidden = effects_to_choose("nothing")
    return [
        labelled("Excitation", dropdown(f"{prefix}excitation", torques(), "paper", searchable=False, **KEPT)),
        labelled("Hidden effect", dropdown(f"{prefix}effect", hidden, "", **KEPT)),
        labelled("Peak torque [N m]", number_field(f"{prefix}amplitude", None, min=0, placeholder="usual")),
        labelled("Length [s]", number_field(f"{prefix}seconds", seconds, min=1, max=LONGEST)),
    ]


def drop(label: Content, id: str, **more: Any) -> Component:
    """A place that files are dropped on."""
    return dcc.Upload(label, id=id, max_size=UPLOAD, className="drop", className_active="drop over", style={}, **more)


def labelled(label: str, control: Component, note: str = "") -> Component:
    """A control with its label, and a word on it."""
    return html.Label([html.Span(label), control, *([html.Small(note)] if note else [])], className="field")


def panel(title: str, *content: Component | str, className: str = "") -> Component:
    """A framed part with a heading."""
    return html.Section([html.H2(title), *content], className=f"panel {className}".strip())


def table(headers: Mapping[str, bool], rows: Sequence[Sequence[Any]], label: str) -> Component:
    """Rows under headers, of which each tells whether its column holds numbers. Wide ones scroll by keyboard, too."""
    of = ["number" if number else None for number in headers.values()]
    head = html.Tr([html.Th(name, scope="col", className=kind) for name, kind in zip(headers, of, strict=True)])
    body = [html.Tr([html.Td(x, className=kind) for x, kind in zip(row, of, strict=True)]) for row in rows]
    return html.Div(
        html.Table([html.Thead(head), html.Tbody(body)]),
        className="scroll",
        tabIndex=0,
        role="region",
        **aria(label=label),
    )
