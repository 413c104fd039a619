"""Add one effect to the model, and show the errors before and after."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from dash import dcc, html
from dash.development.base_component import Component

from estimators import Addition
from pendulum_env.physics.effect_texts import name_effect
from pendulum_env.physics.joints import find_kind
from workbench.app.fits import fit_effect
from workbench.app.panels import show_suggestions
from workbench.app.parts import Stage, label_control, list_choices, make_button, make_panel, show_content, show_section
from workbench.app.session import Session
from workbench.app.state import State as Work
from workbench.errors import InputError
from workbench.narrator.diagnosis import describe_table
from workbench.narrator.tables import JOINT_LEGEND, tabulate_joints
from workbench.report.numbers import make_errors


def show(session: Session) -> list[Component]:
    """Render the effects to add, the added steps, and their errors."""
    state, busy = session.state, session.is_busy()
    offer = show_choice(state, busy, list_choices(state.body, tables=True))
    if state.robot is not None:
        labels = ["base model" if step.added is None else f"+ {step.added}" for step in state.steps]
        errors = [step.errors["holdout"] for step in state.steps]
        table = tabulate_joints(errors, state.result.floors, state.model, labels)
        return [offer, make_panel("Torque errors on held-out data", *show_content([table, JOINT_LEGEND], "joints"))]
    section = make_errors(state.report_data)
    shape = describe_table(state.steps[-1])
    fall = make_panel(section.title, *([html.P(shape)] if shape else []), *show_section(section))
    return [offer, fall] if state.suggested_additions or not state.added else [fall, offer]


def show_choice(state: Work, busy: bool, effects: Mapping[str, str]) -> Component:
    """Render buttons for the selected effects and a list of all others."""
    addable = {id: label for id, label in effects.items() if id not in state.model.effects}
    key = f"beyond {' '.join(state.model.effects)}"  # another model empties the list's choice
    options: dict[str, Any] = {"placeholder": "choose", "persistence": key, "persistence_type": "session"}
    library = label_control(
        "Any effect of the library, or a table", dcc.Dropdown(addable, None, id={"field": "any"}, **options)
    )
    any_of_them = html.Div([library, make_button("Add it", "add-any", disabled=busy)], className="fields wide")
    return make_panel("Add an effect", show_suggestions(state, busy), any_of_them)


def start(session: Session, id: str | None) -> None:
    """Add an effect to the last model in the background.

    Raises UserError if the effect is unknown, or the model has it already.
    """
    if not id:
        raise InputError("choose an effect to add")
    state = session.state
    if state.needs_fit:
        raise InputError("wait until the model is fitted, then add the effect")
    kind = find_kind(id, state.body)
    if kind.id in state.model.effects:
        raise InputError(f"{name_effect(id)} is in the model already")
    task = partial(fit_effect, state.model, id, state.data.recordings, state.data.holdout, state.choices.limits)

    def keep(found: Addition) -> None:
        session.change(f"add {name_effect(id)}", state.add_step(found))

    session.run_task(f"Adding {name_effect(id)}", task, keep)


STAGE = Stage(
    "add",
    "Add",
    show,
    {
        "add": lambda session, id, _: start(session, id),
        "add-any": lambda session, _, form: start(session, form.get("any")),
    },
)
