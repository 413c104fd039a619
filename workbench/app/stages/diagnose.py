"""Diagnose: which effects the model lacks, why, and what to record next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import dash
from dash import ALL, Input, State, dcc, html
from dash.development.base_component import Component

from estimators.diagnosis.result import Diagnosis, Verdict
from pendulum_env.physics import effects
from workbench.app import timing
from workbench.app.asked import NOTHING, Asked
from workbench.app.parts import aria, button, fragment, labelled, panel, table
from workbench.app.recorder import simulated, start_suggested
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.app.state import State as Work
from workbench.app.tasks import start_addition, start_diagnosis
from workbench.report.sections.candidates import Row, candidates
from workbench.report.sections.story import story
from workbench.report.words import listing, name, opening

ADD = "add"  # what a button with an effect's id does
TOP = 6  # candidates that are shown at once


def show(session: Session) -> list[Component]:
    """The search, then its result."""
    state = session.state
    again = state.diagnosis is not None
    busy = session.busy()
    search = panel(
        "Search for what is missing",
        html.P(
            "Every effect of the library is screened for what explains the rest of the torque. It counts as missing "
            "only if it lowers the errors on data it was not fitted to, in torque and in free-running simulation."
        ),
        _asked(session),
        button("Diagnose again" if again else "Diagnose", "diagnose", primary=not again, disabled=busy),
    )
    if state.diagnosis is None:
        return [*timing.show(state), search]
    rows = candidates(state.case).content["rows"]
    return [
        panel(
            "What was found", fragment(story(state.case)), className="story found" if state.told.selected else "story"
        ),
        *timing.show(state),
        *_next(state, busy),
        _alike(state.diagnosis),
        panel(
            "Ranking",
            html.P(
                "The score is the probability that an effect is what the data call for at its place.", className="note"
            ),
            _ranking(rows[:TOP], state.added, busy),
            *(
                [html.Details([html.Summary(f"{len(rows) - TOP} more"), _ranking(rows[TOP:], state.added, busy)])]
                if len(rows) > TOP
                else []
            ),
        ),
        search,
    ]


def _asked(session: Session) -> Component:
    """Fields for what is looked for and what is known; a mistake stands beside its field."""
    tried = session.tried
    faults = {field: opening(session.plain(why)) for field, why in tried.faults(session.state.terms).items()}
    library = [{"label": opening(name(id)), "value": id} for id in effects()]
    kept: dict[str, Any] = {"persistence": True, "persistence_type": "session"}

    def several(label: str, id: str, empty: str) -> Component:
        chosen = [one for one in getattr(tried, id).split(",") if one]
        control = dcc.Dropdown(library, chosen, id=f"ask-{id}", multi=True, placeholder=empty, **kept)
        return labelled(label, control, wrong=faults.get(id, ""))

    def text(label: str, id: str, example: str, note: str) -> Component:
        control = dcc.Input(getattr(tried, id), type="text", id=f"ask-{id}", placeholder=example, **kept)
        return labelled(label, control, note, faults.get(id, ""))

    parameters = ", ".join(column.name for term in session.state.terms for column in term.columns)
    fields = [
        several("Look only for", "only", "every effect"),
        several("Do not look for", "without", "none"),
        text("Values that are known", "fix", "gravity=2.01", f"of {parameters}, and those of effects"),
        text("Bounds of others", "bound", "viscous=0:0.5", "one of the two may be left out; cogging.order=10:14"),
    ]
    summary = html.Summary("Choose what to look for, and say what is known")
    return html.Details([summary, html.Div(fields, className="fields asked")], open=tried != NOTHING)


def _next(state: Work, busy: bool) -> list[Component]:
    """The experiment that would settle what is open, to be recorded at once if the pendulum is a simulated one."""
    suggestion = state.diagnosis.suggestion if state.diagnosis is not None else None
    if suggestion is None or simulated(state) is None:
        return []
    aims = listing([aim.text for aim in suggestion.settles])
    what = f"The same simulated pendulum can play it now: {suggestion.seconds:g} s to {aims}."
    press = button("Record the next experiment", "record-next", primary=not state.found, disabled=busy)
    return [panel("The next experiment", html.P(what), press)]


def _alike(found: Diagnosis) -> Component:
    """Groups that the data cannot tell apart."""
    if not found.ambiguous:
        return html.Div()
    groups = [html.Li(opening(listing([name(id) for id in group], "or"))) for group in found.ambiguous]
    return panel(
        "Effects that look the same",
        html.P("These data cannot tell which of a group it is."),
        html.Ul(groups),
    )


def _ranking(rows: Sequence[Row], added: Sequence[str], busy: bool) -> Component:
    drawn = []
    for row in rows:
        judged = row.candidate
        done = judged.effect in added
        press = button(
            "added" if done else "Add",
            {"do": ADD, "of": judged.effect},
            primary=judged.verdict is Verdict.SELECTED and not done,
            disabled=done or busy,
            **aria(label=f"Add {name(judged.effect)}"),
        )
        drawn.append(
            (
                row.rank,
                [html.Strong(opening(name(judged.effect))), html.Div(row.law, className="law")],
                html.Span(row.verdict, className=f"verdict {judged.verdict}"),
                [
                    f"{judged.score:.2f}",
                    html.Div(html.I(style={"width": f"{100 * judged.score:.1f}%"}), className="meter"),
                ],
                f"{judged.error_ratio:.3f}",
                judged.reason,
                press,
            )
        )
    headers = (
        ("Rank", True),
        ("Effect", False),
        ("Verdict", False),
        ("Score", True),
        ("Error ratio", True),
        ("Reason", False),
        ("", False),
    )
    return html.Div(table(headers, drawn, "Candidates"), className="ranking")


def connect(bench: Bench) -> None:
    """Wire the search, and the buttons that add an effect, wherever they are."""

    @bench.on(
        Input("diagnose", "n_clicks"), given=tuple(State(f"ask-{field.name}", "value") for field in fields(Asked))
    )
    def diagnose(session: Session, _: int, *values: str | list[str] | None) -> None:
        if session.look_for(Asked.of(values)):
            start_diagnosis(session, bench.workers)

    @bench.on(Input("record-next", "n_clicks"))
    def record(session: Session, _: int) -> None:
        start_suggested(session, bench.workers)

    @bench.on(Input({"do": ADD, "of": ALL}, "n_clicks"))
    def add(session: Session, _: list[int]) -> None:
        start_addition(session, bench.workers, dash.ctx.triggered_id["of"])


STAGE = Stage("diagnose", "Diagnose", show, connect)
