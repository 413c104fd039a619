"""A stage of the workbench: a function that draws it from a session, and one that wires its controls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import dash
from dash import Dash, Input, Output, State
from dash.development.base_component import Component
from dash.exceptions import PreventUpdate

from workbench.app.jobs import Workers
from workbench.app.session import Session
from workbench.app.sessions import Sessions

PATIENCE = 0.4  # [s] that an answer waits for a job, so that short ones need no progress bar


@dataclass
class Bench:
    """What all callbacks share: the app, its sessions, its workers, and the survey that it shows if there is one."""

    app: Dash
    sessions: Sessions = field(default_factory=Sessions)
    workers: Workers = field(default_factory=Workers)
    survey: Path | None = None

    def close(self) -> None:
        """End everything."""
        self.sessions.close()
        self.workers.close()

    def on(self, *triggers: Input, given: tuple[State, ...] = ()) -> Callable[[Callable[..., None]], None]:
        """Register what a control does to the session, `do(session, *values)`; the page follows by itself.

        The function runs under the session's lock; a user's mistake becomes the notice on the page.
        """

        def register(do: Callable[..., None]) -> None:
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
                session.act(lambda: do(session, *values[:-1]))
                job = session.job
                if job is not None:
                    job.over.wait(PATIENCE)
                return session.version

        return register


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
