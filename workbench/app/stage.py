"""A stage of the workbench: a function that draws it from a session, and what its buttons do."""

from __future__ import annotations

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
    """One stage.

    Attributes:
        id: of the page's address, `#id`.
        title: in the navigation.
        show: what it looks like now; it reads the session's state once.
        actions: what its buttons and files do, by the name that the button has.
        connect: registers callbacks that do nothing to the session, if it has some.
        needs_model: whether there is nothing to see before a model is fitted.
        headline: kicker, headline and lead of a stage that is not about the loaded recordings.
    """

    id: str
    title: str
    show: Callable[[Session], list[Component]]
    actions: Mapping[str, Action] = field(default_factory=dict)
    connect: Callable[[Dash, Sessions], None] | None = None
    needs_model: bool = True
    headline: tuple[str, str, str] | None = None
