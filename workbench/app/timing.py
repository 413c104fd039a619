"""What is said of torque that is not logged in time with the motion, and the button that corrects it."""

from __future__ import annotations

from dash import Input, html
from dash.development.base_component import Component

from workbench.app.parts import button, panel
from workbench.app.session import Session
from workbench.app.stage import Bench
from workbench.app.state import State
from workbench.report.words import opening

WHY = "No effect does that, and several may be found that only imitate it."


def show(state: State) -> list[Component]:
    """What was found, in the words of the command line; nothing where torque and motion are in time."""
    if state.corrected:
        said = [html.P(f"{opening(text)}: corrected in all that follows.") for text in state.corrected]
        return [_panel(*said, button("Take it as it was logged", "align-back"))]
    if state.timing is None:
        return []
    late, acts = state.timing.texts(True), state.timing.texts(False)
    if late:
        said = [html.P(f"{opening(text)}. {WHY}") for text in late]
        return [_panel(*said, button("Correct it", "align", primary=True))]
    return [_panel(*(html.P(f"{opening(text)}.") for text in acts))] if acts else []


def _panel(*content: Component) -> Component:
    return panel("Torque and motion in time", *content)


def connect(bench: Bench) -> None:
    """Wire the correction and the way back."""

    @bench.on(Input("align", "n_clicks"))
    def correct(session: Session, _: int) -> None:
        session.align(True)

    @bench.on(Input("align-back", "n_clicks"))
    def back(session: Session, _: int) -> None:
        session.align(False)
