"""All sessions of a server, and the stages that show them."""

import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import RLock
from typing import Any

from dash import Dash
from dash.development.base_component import Component

from pendulum_env.recording import Source
from workbench.app.jobs import Workers
from workbench.app.session import Session
from workbench.errors import InputError
from workbench.robot import RobotFile

MOST = 16  # sessions; of more, the one that was used least recently ends
ID = re.compile(r"[0-9a-f]{32}")  # of a session: random, drawn by the page; never part of a path


class Sessions:
    """All sessions of a server by the id that each page holds, and the workers that they share."""

    def __init__(self, recordings: Sequence[Source] = (), robot: RobotFile | None = None) -> None:
        """Make a folder for files from their pages; every session begins with the recordings."""
        self._recordings, self._robot = tuple(recordings), robot
        self.workers = Workers()
        self._folder = tempfile.TemporaryDirectory(prefix="pendulum-ident-", ignore_cleanup_errors=True)
        self._all: dict[str, Session] = {}  # the one used last is last
        self._lock = RLock()

    def find_session(self, id: object) -> Session:
        """Return the session of an id, a new one if there is none; raises InputError if it is no id."""
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        with self._lock:
            session = self._all.pop(id, None) or Session(Path(self._folder.name), self.workers)
            ended = [self._all.pop(k) for k in list(self._all)[: max(0, len(self._all) + 1 - MOST)]]
            self._all[id] = session
        session.begin(self._recordings, self._robot)  # no other session waits for it
        for other in ended:
            other.end()
        return session

    def close(self) -> None:
        """End all sessions and the workers, and delete the files from their pages."""
        with self._lock:
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._folder.cleanup()
        self.workers.close()


Form = Mapping[str, Any]  # values of the controls on the page, or what files came, by name
Action = Callable[[Session, str, Form], object]  # told what the button is of


@dataclass(frozen=True)
class Stage:
    """A stage of the workbench: a function that draws it from a session, and what its buttons do."""

    id: str  # of the page's address, `#id`
    title: str  # in the navigation
    show: Callable[[Session], list[Component]]  # what it looks like now; it reads the session's state once
    # What its buttons and files do, by the name that the button has
    actions: Mapping[str, Action] = field(default_factory=dict)
    # Registers callbacks that do nothing to the session, if it has some
    connect: Callable[[Dash, Sessions], None] | None = None
    needs_model: bool = True  # whether there is nothing to see before a model is fitted
