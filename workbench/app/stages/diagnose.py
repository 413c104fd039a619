"""Find the missing effects, and show the evidence and the next experiment."""

from dataclasses import replace
from functools import partial

from dash import dcc, html
from dash.development.base_component import Component

from estimators import Diagnosis, diagnose
from workbench.app.fits import fit_and_diagnose
from workbench.app.jobs import Task
from workbench.app.panels import show_suggestions, show_timing
from workbench.app.parts import (
    KEPT,
    Stage,
    label_control,
    list_choices,
    make_button,
    make_late,
    make_panel,
    show_section,
)
from workbench.app.session import Session
from workbench.app.state import NO_CHOICES, SearchChoices
from workbench.app.state import State as Work
from workbench.options import parse_effects
from workbench.report.data import ReportData
from workbench.report.evidence import make_candidates
from workbench.report.matches import make_rivals
from workbench.report.story import make_joints, make_story


def show(session: Session) -> list[Component]:
    """Render the options of the search, and its last result."""
    state, busy = session.state, session.is_busy()
    diagnosis = state.diagnosis
    search = make_panel(
        "Search for what is missing",
        html.P(
            "The effects of the library are tried, for an arm at each joint. An effect is missing if it lowers "
            "the errors on held-out data, in torque and, for a pendulum, in free-running simulation."
        ),
        show_choices(state, is_open=state.choices != NO_CHOICES or bool(session.notice)),
        make_button(
            "Diagnose" if diagnosis is None else "Diagnose again", "diagnose", primary=diagnosis is None, disabled=busy
        ),
    )
    if diagnosis is None:
        return [make_late("timing"), search]
    make = make_story if state.robot is None else make_joints
    result = make(ReportData(state.result))
    return [
        make_panel("What was found", *show_section(result), className="story"),
        make_late("rivals", make_panel("Why", html.P("The rivals are fitted …")) if diagnosis.selected else None),
        make_late("timing"),
        make_panel(
            "Evidence",
            show_suggestions(state, busy),
            *show_section(make_candidates(ReportData(diagnosis))),
            className="ranking",
        ),
        search,
    ]


def show_rivals(session: Session) -> Component | None:
    """Render each effect of the diagnosis beside its nearest rivals; None without an effect."""
    diagnosis = session.state.diagnosis
    section = make_rivals(ReportData(diagnosis)) if diagnosis is not None else None
    return make_panel(section.title, *show_section(section)) if section is not None else None


def show_choices(state: Work, is_open: bool) -> Component:
    """Render the fields for effects to look for and, for a pendulum, known values; invalid text stays."""
    choices, library, has_limits = state.choices, list_choices(state.body), state.body.can_limit

    def make_list(label: str, id: str, empty: str) -> Component:
        effects, field = parse_effects(getattr(choices, id)), {"field": f"ask-{id}"}
        return label_control(label, dcc.Dropdown(library, effects, id=field, multi=True, placeholder=empty, **KEPT))

    def make_field(label: str, id: str, example: str, note: str) -> Component:
        control = dcc.Input(getattr(choices, id), type="text", id={"field": f"ask-{id}"}, placeholder=example, **KEPT)
        return label_control(label, control, note)

    parameters = ", ".join(column.name for term in state.base_terms for column in term.columns)
    names = f"of {parameters}, and those of effects: ID or ID.NAME"
    effects = "one of the two may be left out; cogging.order=10:14"
    lists = [make_list("Look only for", "only", "every effect"), make_list("Do not look for", "without", "none")]
    limits = [
        make_field("Values that are known", "fix", "gravity=2.01", names),
        make_field("Bounds of others", "bound", "viscous=0:0.5", effects),
    ]
    summary = html.Summary(f"Choose the effects to look for{', and enter known values' if has_limits else ''}")
    groups = [
        html.Div(lists, className="fields asked"),
        html.Div(limits, className="fields asked", hidden=not has_limits),
    ]
    return html.Details([summary, *groups], open=is_open)


def choose_search(session: Session, choices: SearchChoices) -> None:
    """Set the options of the search; raises ValueError if they are invalid."""
    choices.check(session.state.base_terms)
    if choices != (state := session.state).choices:  # other known values need new fits
        change = replace(state, choices=choices)
        if choices.limits != state.choices.limits:
            change = state.restart(choices=choices)
        session.change("choose what is looked for", change)


def start(session: Session, choices: SearchChoices) -> None:
    """Diagnose the last model in the background, after the fit of the base model if needed."""
    choose_search(session, choices)
    state = session.state

    def keep(found: Diagnosis, fitted: Work = state) -> None:
        session.change("diagnose", fitted.add_diagnosis(found))

    if state.needs_fit:
        task: Task = partial(fit_and_diagnose, state.make_fit_task(), choices.effects, choices.limits)
        session.run_task("Diagnosing", task, lambda results: keep(results[1], state.with_fit(results[0])))
    else:
        data, options = state.data, choices.effects | choices.limits
        task = partial(diagnose, data.recordings, data.holdout, state.model.terms, **options)
        session.run_task("Diagnosing", task, keep)


STAGE = Stage(
    "diagnose",
    "Diagnose",
    show,
    {"diagnose": lambda session, _, form: start(session, SearchChoices.from_form(form))},
    {"rivals": show_rivals, "timing": show_timing},
)
