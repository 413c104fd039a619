"""Headline, running job, undo button, and panels shared by several stages."""

from dataclasses import replace

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise, join_words
from pendulum_env.physics import BASE
from pendulum_env.physics.effect_texts import name_effect, name_effects, name_parameter
from workbench.app.parts import make_aria, make_button, make_panel
from workbench.app.session import Session
from workbench.app.state import State
from workbench.narrator.diagnosis import describe_errors, describe_fall, describe_result, describe_unconfirmed
from workbench.narrator.findings import describe, describe_timing

WHY = "No effect of the library does that, but several imitate it."
LEAST = 0.1  # completed share from which the remaining time is estimated
RANKED = 5  # largest number of effects in the ranking of a running search
NBSP = "\N{NO-BREAK SPACE}"  # between a number and its unit


def show_state(state: State) -> list[Component]:
    """Render the headline with the line above and the sentence below."""
    kicker, title, lead = describe_state(state)
    return [html.P(kicker, className="kicker"), html.H1(title), html.P(lead, className="lead")]


def show_undo(session: Session) -> list[Component]:
    """Render the buttons for undo and redo; empty without recordings and changes."""
    change, is_busy = session.last_change, session.is_busy()
    if not (change or session.undone or session.state.loaded):
        return []
    back = make_button(f"Undo: {change}" if change else "Undo", "back", disabled=is_busy or not change)
    again = [make_button(f"Redo: {change}", "again", disabled=is_busy) for change, _ in session.undone[-1:]]
    return [html.Div([back, *again], className="row")]


def describe_state(state: State) -> tuple[str, str, str]:
    """Return the kicker (line above), headline and lead (sentence below) of a state."""
    if not state.loaded and state.robot is None:
        text = (
            "Load recordings of a pendulum or an arm, see where the model fails, learn which physical effect it lacks, "
            "add it, and watch the error fall."
        )
        return "Workbench", "What does your model lack?", text
    count = len(state.loaded)
    robot = f"{state.robot.file.name} · " if state.robot is not None else ""
    seconds = sum(item.recording.duration for item in state.loaded)
    kicker = f"{robot}{count} recording{'s' if count != 1 else ''}, {seconds:.3g} s"
    if state.failure_reason:
        title = "Fitting the model" if state.needs_fit else "Nothing can be fitted yet"
        return kicker, title, f"{capitalise(state.failure_reason)}."
    kicker += f" · model: {state.model_file or 'base'}{''.join(f' + {name_effect(effect)}' for effect in state.added)}"
    result, drawn = state.result, replace(state.result, steps=state.steps)
    lead = f"{capitalise(describe_errors(drawn))}."
    unconfirmed = describe_unconfirmed(result, state.added)
    if state.suggested_additions:
        names = f"{name_effects(state.suggested_additions)}{' instead' * bool(unconfirmed)}"
        lead += f" With {names}: {describe_errors(result)}."
    is_open = state.suggested_additions or not state.added
    return kicker, f"{describe_result(result) if is_open else describe_fall(drawn)}{unconfirmed}", lead


def show_job(session: Session) -> list[Component]:
    """Render the running job and its duration."""
    job = session.job
    if job is None or not job.running:
        return []
    step, errors = job.progress
    progress = f" {step} · {job.elapsed:.0f}{NBSP}s so far"
    if job.share > LEAST:
        progress += f", about {job.elapsed * (1 / job.share - 1):.0f}{NBSP}s left"
    text = html.Div([html.Strong(job.title), html.Span(progress, className="note")])
    bar = html.Progress(value=str(round(job.share, 3)), max="1", **make_aria(label=job.title))
    largest, ranking = max(errors.values(), default=0.0), sorted(errors, key=errors.__getitem__)[:RANKED]
    shares = [html.Progress(value=f"{1 - (errors[id] / largest) ** 2:.3f}", max="1") for id in ranking]
    rows = [html.Li([capitalise(name_effect(id)), share]) for id, share in zip(ranking, shares, strict=True)]
    so_far = [html.P("These explain most of the residual so far:", className="note"), html.Ol(rows)] if rows else []
    return [html.Div([text, bar, *so_far], className="running-text")]


def show_findings(state: State) -> Component:
    """Render the parameters that the recordings determine, and findings on the others."""
    withheld = {parameter for doubt in state.doubts for parameter in doubt.withheld}
    terms = BASE if state.failure_reason else state.model.terms
    is_relative = not state.failure_reason and state.model.torque_unit == "rad/s^2"  # of a free swing
    unknown = withheld | ({"inertia"} if is_relative else set())
    known = [name_parameter(column.name) for term in terms for column in term.columns if column.name not in unknown]
    relative = ", relative to the inertia." if is_relative else "."
    known_text = [html.P(["They tell ", html.Strong(join_words(known)), relative])] if known and state.fit else []
    result = state.diagnosis or state.fit
    findings = [*(result.disagreements if result is not None else ()), *state.doubts]
    texts = [*filter(None, [state.failure_reason]), *map(describe, findings)]
    cannot = [html.Ul([html.Li(capitalise(text)) for text in texts])] if texts else []
    return make_panel("What these recordings tell, and what not", *known_text, *cannot)


def show_timing(session: Session) -> Component | None:
    """Render findings on the timing of the torque, with a button to correct it; None without findings."""
    state = session.state
    if not state.body.can_simulate:
        return None
    late, slow = (state.torque_timing.find(is_late) for is_late in (True, False))
    remedy = "It is corrected in all that follows." if state.is_aligned else WHY
    texts = [describe_timing(law, remedy) for law in late] or [describe(law) for law in slow]
    _ = state.report_data.schemes  # fitted here, so that the stage Model opens at once
    buttons = [make_button("Correct it", "align", primary=True)] if late and not state.is_aligned else []
    return make_panel("Torque and motion in time", *map(html.P, texts), *buttons) if texts else None


def show_suggestions(state: State, busy: bool) -> Component:
    """Render buttons to add the effects selected by the diagnosis, or the state if none is left to add."""
    if state.diagnosis is None:
        link = html.A("diagnose", href="#diagnose")
        return html.P(["The diagnosis tells which effect is missing: ", link, " first, or try any."])
    offers = [(f"Add {name_effect(effect)}", effect) for effect in state.suggested_additions]
    table = next(iter(state.result.tables), None)  # table for an unknown law
    if not offers and table is not None and table not in state.model.effects:
        offers = [(f"Keep {name_effect(table)} as a table", table)]
    presses = [make_button(label, "add", id, primary=k == 0, disabled=busy) for k, (label, id) in enumerate(offers)]
    remainder = "no effect of the library explains the rest of the residual" if state.result.unexplained else ""
    if state.suggested_additions:
        text = "The diagnosis calls for it:"
    elif state.suggested_effects:
        text = f"All that the diagnosis calls for is in the model{', but ' if remainder else ''}{remainder}."
    else:
        text = f"{capitalise(remainder) or 'The diagnosis calls for no effect'}."
    return html.Div([html.P(text), html.Div(presses, className="row")])
