"""The story so far: the headline, the numbers behind it, the running job and the way back."""

from dataclasses import replace

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise, format_number, join_words
from workbench.app.parts import make_aria, make_button
from workbench.app.session import Session
from workbench.app.state import State
from workbench.narrator.diagnosis import describe_errors, describe_result
from workbench.narrator.effects import name_effect
from workbench.narrator.results import get_end_errors

NBSP = "\N{NO-BREAK SPACE}"  # between a number and its unit


def show_state(state: State) -> list[Component]:
    """Show the headline, and the numbers behind it."""
    kicker, title, lead = describe_state(state)
    return [html.P(kicker, className="kicker"), html.H1(title), html.P(lead, className="lead")]


def show_undo(session: Session) -> list[Component]:
    """Show the way back."""
    what = session.last_change
    if not (what or session.state.loaded):
        return []
    back = make_button(f"Undo: {what}" if what else "Undo", "back", disabled=session.is_busy() or not what)
    return [html.Div(back, className="row")]


def describe_state(state: State) -> tuple[str, str, str]:
    """Return kicker, headline and lead of a state."""
    if not state.loaded and state.robot is None:
        what = (
            "Load recordings of a pendulum or an arm, see where the model fails, learn which physical effect it lacks, "
            "add it, and watch the error fall."
        )
        return "Workbench", "What does your model lack?", what
    count = len(state.loaded)
    robot = f"{state.robot.file.name} · " if state.robot is not None else ""
    kicker = f"{robot}{count} recording{'s' if count != 1 else ''}, {state.seconds:.3g} s"
    if state.trouble:
        title = "Fitting the model" if state.needs_fit else "Nothing can be fitted yet"
        return kicker, title, f"{capitalise(state.trouble)}."
    kicker += f" · model: {state.model_file or 'base'}{''.join(f' + {name_effect(effect)}' for effect in state.added)}"
    lead = f"{capitalise(describe_errors(replace(state.result, steps=state.ladder)))}."
    if state.found:
        found = join_words([name_effect(effect) for effect in state.found])
        lead += f" With {found}: {describe_errors(state.result)}."
    if state.found or not state.added:
        return kicker, describe_result(state.result), lead
    (first, last), names = get_end_errors(state.ladder), join_words([name_effect(effect) for effect in state.added])
    smaller, joint = max((first.get_joint_error(at) / last.get_joint_error(at), at) for at in state.result.floors)
    error = f"torque error of {joint}" if joint else "torque error"
    return kicker, f"With {names} the {error} is {format_number(smaller, 2)} times smaller", lead


def show_job(session: Session) -> list[Component]:
    """Render the running job, its duration, and a button to cancel it."""
    job = session.job
    if job is None or not job.running:
        return []
    said = f" {job.what} · {job.elapsed:.0f}{NBSP}s so far"
    what = html.Div([html.Strong(job.title), html.Span(said, className="note")])
    bar = html.Progress(value=str(round(job.share, 3)), max="1", **make_aria(label=job.title))
    return [html.Div([what, bar], className="running-text"), make_button("Cancel", "cancel")]
