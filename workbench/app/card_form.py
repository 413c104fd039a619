"""Form for the roles, units and gains of a file's columns."""

from dataclasses import replace
from typing import Any

import numpy as np
from dash import dcc, html
from dash.development.base_component import Component

from workbench.app.card import UNWRAP, ColumnCard, describe_unit, get_quantity, list_units
from workbench.app.parts import make_aria, make_button, make_panel, make_table

COLUMNS = "Time and position are needed, and torque if anything drives the joint; velocity and reference are of use."
FREE = "Nothing drives the joint: torque is zero"
COLUMNS_OF_ARM = (
    "Time, and position and torque of each joint are needed, on the side of the joint; the torque holds the "
    "links up. For columns of a motor before its gear, write the ratio in the last column; for a current, its gain."
)
HINTS = {  # example conversions by quantity
    "time": "*0.001",
    "position": "/6 or *-1 or +90",
    "velocity": "/6 or *-1",
    "torque": "*0.091, *? or *-1",
    "reference": "/6 or *-1 or +90",
}
UNIT_LABELS = {"A": "A: current", "V": "V: voltage", "duty": "duty: share of the supply"}


def show(card: ColumnCard) -> Component:
    """Render the first rows of a file and the choices for its columns."""
    return make_panel(
        f"What the columns of {card.source.file.name} mean",
        *([html.P(f"{card.error}.", className="why", role="alert")] if card.error else []),
        html.P(
            f"{COLUMNS_OF_ARM if card.joints else COLUMNS} The last column converts a column by gain, "
            "ratio and offset. The current, voltage or duty cycle of a motor needs its torque constant"
            f"{'' if card.joints else ', or *? to find it from known loads'}.",
            className="note",
        ),
        make_table(
            dict.fromkeys(("Column", "First rows", "It is", "In", "Gain, ratio, offset"), ""),
            [_make_row(card, k) for k in range(len(card.choices))],
            "Columns",
        ),
        dcc.Checklist([{"label": UNWRAP, "value": "unwrap"}], ["unwrap"] * card.source.unwrap, id=_make_id("unwrap")),
        *(
            []
            if card.joints
            else [dcc.Checklist([{"label": FREE, "value": "free"}], ["free"] * card.is_free, id=_make_id("free"))]
        ),
        html.Div(
            [
                make_button("Read it again" if card.loaded_id else "Load it", "card-load", primary=True),
                make_button("Leave it as it is" if card.loaded_id else "Leave it out", "card-close"),
            ],
            className="row",
        ),
        className="card",
    )


def _make_id(field: str, k: int = 0) -> dict[str, Any]:
    """Make the pattern-matching id of a control; the controls are not always on the page."""
    return {"field": field, "of": k}


def _make_row(card: ColumnCard, k: int) -> tuple[Any, ...]:
    """Make the table row of column `k`: header, first values, role, unit and conversion."""
    header, choice, values = card.preview.headers[k], card.choices[k], card.preview.values[k]
    first_values = "no numbers"
    if values is not None:
        first_values = ", ".join(f"{x + 0.0:.5g}" if np.isfinite(x) else "–" for x in values[:4]) + ", …"
    roles = {"": "unused"} | {role: role for role in card.roles}
    without_unit = replace(choice, unit="").write_expression(header)
    unit = (describe_unit(choice.role, without_unit, card.preview.headers) if choice.role else "") or "–"
    units = {"": unit} | {name: UNIT_LABELS.get(name, name) for name in [*list_units(choice.role), choice.unit] if name}
    options: dict[str, Any] = {"clearable": False, "searchable": False, "disabled": values is None}
    conversion = dcc.Input(
        choice.conversion,
        type="text",
        id=_make_id("conversion", k),
        placeholder=HINTS.get(get_quantity(choice.role), ""),
        disabled=values is None or not choice.role,
        persistence=card.source.file.name,  # typed text survives a redraw of the card
        persistence_type="memory",
    )
    return (
        html.Strong(header),
        first_values,
        html.Div(
            dcc.Dropdown(roles, choice.role, id=_make_id("role", k), **options), **make_aria(label=f"Role of {header}")
        ),
        html.Div(
            dcc.Dropdown(units, choice.unit, id=_make_id("unit", k), **options), **make_aria(label=f"Unit of {header}")
        ),
        conversion,
    )
