"""Diagnose: which effects the model lacks, why, and what to record next."""

from __future__ import annotations

from collections.abc import Sequence

import dash
from dash import ALL, Input, html
from dash.development.base_component import Component

from estimators.diagnosis.result import Diagnosis, Verdict
from workbench.app import timing
from workbench.app.parts import aria, button, fragment, panel, table
from workbench.app.recorder import simulated, start_suggested
from workbench.app.session import Session
from workbench.app.stage import Bench, Stage
from workbench.app.state import State
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


def _next(state: State, busy: bool) -> list[Component]:
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

    @bench.on(Input("diagnose", "n_clicks"))
    def diagnose(session: Session, _: int) -> None:
        start_diagnosis(session, bench.workers)

    @bench.on(Input("record-next", "n_clicks"))
    def record(session: Session, _: int) -> None:
        start_suggested(session, bench.workers)

    @bench.on(Input({"do": ADD, "of": ALL}, "n_clicks"))
    def add(session: Session, _: list[int]) -> None:
        start_addition(session, bench.workers, dash.ctx.triggered_id["of"])


STAGE = Stage("diagnose", "Diagnose", show, connect)
