"""Add: one effect more, the errors before and after, and the way back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from dash import Input, State, dcc, html
from dash.development.base_component import Component

from estimators.selection.data import Step
from pendulum_env.physics import effects
from workbench.app.parts import button, fragment, graph, labelled, panel
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.app.stages.diagnose import ADD
from workbench.app.state import State as Work
from workbench.app.state import ids
from workbench.app.tasks import start_addition
from workbench.mistakes import InputError
from workbench.report.figure import Figure, axis, numbers
from workbench.report.sections.errors import PARTS, errors
from workbench.report.words import listing, name, number, opening

PATTERNS = {"train": {"shape": "/", "fillmode": "replace", "size": 6, "solidity": 0.4}, "holdout": {"shape": ""}}

HEADROOM = 1.4  # times the highest bar, for its number


def show(session: Session) -> list[Component]:
    """What could be added, the ladder, and its numbers."""
    state = session.state
    steps = state.ladder
    floor = state.told.noise_floor
    ladder = html.Div(
        [
            graph(falling(steps, "torque_rms", "torque error [N m]", floor)),
            graph(falling(steps, "position_rms", "free-running position error [rad]", None)),
        ],
        className="columns even",
    )
    undo = button(f"Take {name(state.added[-1])} out", "undo", disabled=session.busy()) if state.added else None
    fall = panel(
        "How the error falls", html.P(said(steps), className="before-after"), ladder, *([undo] if undo else [])
    )
    choice = _choice(state, session.busy())
    return [
        *([choice, fall] if state.found or not state.added else [fall, choice]),
        panel("Errors step by step", fragment(errors(state.standing))),
    ]


def said(steps: Sequence[Step]) -> str:
    """The last step in words."""
    if len(steps) == 1:
        return "The ladder has one rung, the base model. Add an effect and watch both errors, fitted and held out."
    before, after = steps[-2], steps[-1]
    told = []
    for part, where in (("train", "fitted"), ("holdout", "held-out")):
        old, new = before.errors[part].torque_rms, after.errors[part].torque_rms
        told.append(f"from {number(old)} to {number(new)} N m on {where} data")
    return f"With {name(after.added or '')} the torque error goes {listing(told)}."


def falling(steps: Sequence[Step], quantity: str, title: str, floor: float | None) -> Figure:
    """Bars of one kind of error, step by step."""
    labels = ["base model", *(f"+ {name(step.added)}" for step in steps if step.added)]
    data, tops = [], [floor or 0.0]
    for part, label, _, _ in PARTS:
        values = np.array([getattr(step.errors[part], quantity) for step in steps])
        tops.append(float(np.nan_to_num(values).max()))
        shades = ["--base", *["--between"] * (len(steps) - 2), *["--final"][: len(steps) - 1]]
        data.append(
            {
                "type": "bar",
                "name": label,
                "x": list(range(len(steps))),
                "y": numbers(values),
                "text": [number(value, 2) for value in values],
                "textposition": "outside",
                "textangle": -90,  # side by side they would collide where there are many bars, or a small screen
                "constraintext": "none",
                "cliponaxis": False,
                "marker": {"color": shades, "pattern": PATTERNS[part]},
                "hovertemplate": f"{label}: %{{y:.3g}}<extra></extra>",
            }
        )
    edge = [-0.6, max(len(steps), 2) - 0.4]  # one bar alone should not fill the plot
    if floor is not None:
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": "noise floor",
                "x": edge,
                "y": [floor, floor],
                "line": {"color": "--muted", "width": 1.5, "dash": "dash"},
                "hovertemplate": "noise floor: %{y:.3g}<extra></extra>",
            }
        )
    layout = {
        "xaxis": axis(
            "", tickvals=list(range(len(steps))), ticktext=labels, range=edge, showgrid=False, zeroline=False
        ),
        "yaxis": axis(title, range=[0, HEADROOM * max(tops)]),
        "barmode": "group",
        "bargap": 0.35,
        "margin": {"t": 40},
    }
    return Figure(f"falling-{quantity}", f"{title} after every step", data, layout, 330)


def _choice(state: Work, busy: bool) -> Component:
    """What the diagnosis calls for, or any effect of the library."""
    parts: list[Component | str] = []
    if state.found:
        calls = [
            button(f"Add {name(effect)}", {"do": ADD, "of": effect}, primary=k == 0, disabled=busy)
            for k, effect in enumerate(state.found)
        ]
        parts += [html.P("The diagnosis calls for it:"), html.Div(calls, className="row")]
    elif state.diagnosis is None:
        parts.append(
            html.P(
                [
                    "The diagnosis tells which effect is missing: ",
                    html.A("diagnose", href="#diagnose"),
                    " first, or try any.",
                ]
            )
        )
    elif state.astray:
        parts.append(html.P("The model has left the diagnosis: undo, or diagnose again from here."))
    else:
        parts.append(html.P(settled(state)))
    others = [{"label": opening(name(id)), "value": id} for id in effects() if id not in state.model.effects]
    kept: dict[str, Any] = {  # while a job ends and the page is drawn anew; a model with an effect more asks anew
        "persistence": f"beyond {' '.join(state.model.effects)}",
        "persistence_type": "session",
    }
    library = labelled("Any effect of the library", dcc.Dropdown(others, None, id="any", placeholder="choose", **kept))
    return panel(
        "Add an effect",
        *parts,
        html.Div([library, button("Add it", "add-any", disabled=busy)], className="fields wide"),
    )


def settled(state: Work) -> str:
    """What is left to do where the diagnosis calls for nothing more."""
    rest = "something is left that no effect of the library explains" if state.told.unexplained else ""
    if not ids(state.called_for):
        return f"{opening(rest) or 'The diagnosis calls for no effect'}."
    return f"All that the diagnosis calls for is in the model{', but ' if rest else ''}{rest}."


def connect(bench: Bench) -> None:
    """Wire undo, and the choice of any effect."""

    @bench.on(Input("undo", "n_clicks"))
    def undo(session: Session, _: int) -> None:
        session.state = session.state.undone()

    @bench.on(Input("add-any", "n_clicks"), given=(State("any", "value"),))
    def add(session: Session, _: int, effect: str | None) -> None:
        if not effect:
            raise InputError("choose an effect to add")
        start_addition(session, bench.workers, effect)


STAGE = Stage("add", "Add", show, connect)
