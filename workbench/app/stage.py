"""A stage of the workbench: a function that draws it from a session, and one that wires its controls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dash
from dash import ALL, Dash, Input, Output, State
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from workbench.app.session import Session
from workbench.app.sessions import Sessions

PATIENCE = 0.4  # [s] that an answer waits for a job, so that short ones need no progress bar


@dataclass
class Bench:
    """What all callbacks share: the app, its sessions, and the survey that it shows if there is one."""

    app: Dash
    sessions: Sessions = field(default_factory=Sessions)
    survey: Path | None = None

    def on(self, *triggers: Input, given: tuple[State, ...] = (), urgent: bool = False) -> Callable[[Any], None]:
        """Register what a control does to the session, `do(session, *values)`; the page follows by itself.

        The function runs under the session's lock, not while a job does, and a user's mistake becomes the notice on the
        page; an urgent one runs at once whatever goes on.
        """

        def register(do: Callable[..., object]) -> None:
            @self.app.callback(
                Output("version", "data", allow_duplicate=True),
                *triggers,
                *given,
                State("session", "data"),
                prevent_initial_call=True,
            )
            def run(*values: Any) -> int:
                if not any(entry["value"] for entry in dash.ctx.triggered):  # a control that has just appeared
                    raise PreventUpdate
                session = self.sessions.of(values[-1])
                if urgent:
                    do(session, *values[:-1])
                    return session.version
                session.act(lambda: do(session, *values[:-1]))
                job = session.job
                if job is not None:
                    job.over.wait(PATIENCE)
                return session.version

        return register

    def buttons(self, does: Mapping[str, Callable[[Session], object]], urgent: bool = False) -> None:
        """Register what buttons do to the session, by their ids."""
        for id, do in does.items():
            self.on(Input(id, "n_clicks"), urgent=urgent)(lambda session, _, do=do: do(session))

    def each(self, does: Mapping[str, Callable[[Session, str], object]]) -> None:
        """Register what buttons `{"do": what, "of": which}` do to the session, told which."""
        for what, do in does.items():
            self.on(Input({"do": what, "of": ALL}, "n_clicks"))(
                lambda session, _, do=do: do(session, dash.ctx.triggered_id["of"])
            )


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        id: of the page's address, `#id`.
        title: in the navigation.
        show: what it looks like now; it reads the session's state once.
        connect: registers its callbacks.
        needs_model: whether there is nothing to see before a model is fitted.
        headline: kicker, headline and lead of a stage that is not about the loaded recordings.
    """

    id: str
    title: str
    show: Callable[[Session], list[Component]]
    connect: Callable[[Bench], None]
    needs_model: bool = True
    headline: tuple[str, str, str] | None = None
