"""Parts of which the stages are built."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dash import dcc, html
from dash.development.base_component import Component

from workbench.report import page
from workbench.report.figure import Figure
from workbench.report.section import Section

Content = Component | str | Sequence[Component | str] | None

PLOT, SPEC = "plot", "spec"  # a graph, and the figure that it draws in the page's colours
BUTTONS = ["zoom2d", "pan2d", "resetScale2d", "toImage"]  # by name, so that none that sends data elsewhere slips in
CLEAR = "rgba(0,0,0,0)"
EMPTY = {  # a graph before its figure comes
    "layout": {
        "xaxis": {"visible": False},
        "yaxis": {"visible": False},
        "paper_bgcolor": CLEAR,
        "plot_bgcolor": CLEAR,
    }
}


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


CONTROLS = {  # what the command line calls otherwise
    "the other commands do with --align": "the button “Correct it” does so in all stages",
    "correct it with --align (`Aligned.of` in Python)": "the button “Correct it” does so",
}


def fragment(section: Section) -> Component:
    """Text and tables of a section of the report, in its own words but for options; figures are left to `graph`."""
    markup = page.fragment(section)
    for option, control in CONTROLS.items():
        markup = markup.replace(option, control)
    return html.Div(
        [
            dcc.Store(id={"kind": "markup", "of": section.id}, data=markup),
            html.Div(id={"kind": "fragment", "of": section.id}, className="fragment"),
        ]
    )


def button(label: Content, id: Any, primary: bool = False, **more: Any) -> Component:
    """A button."""
    return html.Button(
        label, id=id, type="button", className="action primary" if primary else "action", **({"n_clicks": 0} | more)
    )


def labelled(label: str, control: Component, note: str = "", wrong: str = "") -> Component:
    """A control with its label, and a word on it, or what is wrong with what it holds."""
    said = html.Small(wrong, className="wrong", role="alert") if wrong else html.Small(note) if note else None
    return html.Label([html.Span(label), control, *([said] if said else [])], className="field")


def panel(title: str, *content: Component | str, className: str = "") -> Component:
    """A framed part with a heading."""
    return html.Section([html.H2(title), *content], className=f"panel {className}".strip())


def table(headers: Sequence[tuple[str, bool]], rows: Sequence[Sequence[Any]], label: str) -> Component:
    """Rows under headers; a header says whether its column holds numbers. Wide ones scroll by keyboard, too."""

    def cell(value: Any, number: bool) -> Component:
        return html.Td(value, className="number" if number else None)

    head = html.Tr([html.Th(name, scope="col", className="number" if number else None) for name, number in headers])
    body = [html.Tr([cell(value, number) for value, (_, number) in zip(row, headers, strict=True)]) for row in rows]
    return html.Div(
        html.Table([html.Thead(head), html.Tbody(body)]),
        className="scroll",
        tabIndex=0,
        role="region",
        **aria(label=label),
    )
