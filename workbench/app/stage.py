"""A stage of the workbench: a function that draws it from a session, and what its buttons do."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from dash import Dash
from dash.development.base_component import Component

from workbench.app.session import Session, Sessions

Form = Mapping[str, Any]  # values of the controls on the page, or what files came, by name
Action = Callable[[Session, str, Form], object]  # told what the button is of


@dataclass(frozen=True)
class Stage:
    """One stage."""

    id: str  # of the page's address, `#id`
    title: str  # in the navigation
    show: Callable[[Session], list[Component]]  # what it looks like now; it reads the session's state once
    # What its buttons and files do, by the name that the button has
    actions: Mapping[str, Action] = field(default_factory=dict)
    # Registers callbacks that do nothing to the session, if it has some
    connect: Callable[[Dash, Sessions], None] | None = None
    needs_model: bool = True  # whether there is nothing to see before a model is fitted
    # Kicker, headline and lead of a stage that is not about the loaded recordings
    headline: tuple[str, str, str] | None = None
