"""Panels that several stages show."""

from dash import html
from dash.development.base_component import Component

from pendulum_env.formatting import capitalise, join_words
from pendulum_env.physics import BASE
from workbench.app.parts import make_button, make_panel
from workbench.app.state import State
from workbench.narrator.diagnosis import describe_disagreement
from workbench.narrator.effects import name_effect
from workbench.narrator.findings import describe, describe_late

WHY = "No effect of the library does that, but several imitate it."


def show_findings(state: State) -> Component:
    """Show what the recordings tell, and what not."""
    withheld = {parameter for doubt in state.doubts for parameter in doubt.withheld}
    terms = BASE if state.trouble else state.model.terms
    known = [name_effect(column.name) for term in terms for column in term.columns if column.name not in withheld]
    can = [] if state.trouble or not known else [html.P(["They tell ", html.Strong(join_words(known)), "."])]
    found = state.diagnosis or state.fit
    texts = [state.trouble] if state.trouble else []
    texts += map(describe_disagreement, found.disagreements if found is not None else ())
    texts += map(describe, state.doubts)
    cannot = html.Ul([html.Li(capitalise(text)) for text in texts])
    nothing = html.P("They determine all parameters of the model.")
    return make_panel("What these recordings tell, and what not", *can, cannot if texts else nothing)


def show_timing(state: State) -> list[Component]:
    """Render the finding on timing as on the command line; empty without one."""
    if state.fit is None or not (state.fit.late or state.fit.slow):
        return []
    press = []
    if state.fit.late:
        said = "It is corrected in all that follows." if state.is_aligned else WHY
        texts = [describe_late(own, said) for own in state.fit.late]
        press = [] if state.is_aligned else [make_button("Correct it", "align", primary=True)]
    else:
        texts = [describe(own) for own in state.fit.slow]
    return [make_panel("Torque and motion in time", *map(html.P, texts), *press)]


def show_calls(state: State, busy: bool) -> Component:
    """Render the effects that the diagnosis selected, or the next step if all are added."""
    if state.diagnosis is None:
        link = html.A("diagnose", href="#diagnose")
        return html.P(["The diagnosis tells which effect is missing: ", link, " first, or try any."])
    offers = [(f"Add {name_effect(effect)}", effect) for effect in state.found]
    table = next(iter(state.result.tables), None)  # a function that no effect is and that would explain what is left
    if not offers and table is not None and table not in state.model.effects:
        offers = [(f"Keep {name_effect(table)} as a table", table)]
    presses = [make_button(label, "add", id, primary=k == 0, disabled=busy) for k, (label, id) in enumerate(offers)]
    why = html.P("The diagnosis calls for it:" if state.found else describe_rest(state))
    return html.Div([why, html.Div(presses, className="row")])


def describe_rest(state: State) -> str:
    """Render the next step after all selected effects are added."""
    rest = "no effect of the library explains the rest of the residual" if state.result.unexplained else ""
    if not state.called:
        return f"{capitalise(rest) or 'The diagnosis calls for no effect'}."
    return f"All that the diagnosis calls for is in the model{', but ' if rest else ''}{rest}."
