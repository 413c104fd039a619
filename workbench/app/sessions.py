"""All sessions of a server, each apart from all others."""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from threading import RLock

from pendulum_env.recording import Source
from workbench.app.session import Session
from workbench.mistakes import InputError

ID = re.compile(r"[0-9a-f]{32}")  # random, drawn by the page; never part of a path
MOST_SESSIONS = 16  # the one that was used least recently gives way
IDLE = 12 * 3600.0  # [s] after which a session that nobody has asked for ends


class Sessions:
    """All sessions of a server by the id that each page holds."""

    def __init__(self, recordings: Sequence[Source] = (), rig: Path | None = None) -> None:
        """Make a folder for their folders; every session begins with a copy of the recordings, and may run the rig."""
        self._initial, self._rig = tuple(recordings), rig
        self._root = tempfile.TemporaryDirectory(prefix="pendulum-ident-")
        self._all: dict[str, Session] = {}
        self._asked: dict[str, float] = {}  # when for each [s]
        self._lock = RLock()

    def of(self, id: object) -> Session:
        """Session of an id, a new one if there is none.

        Raises:
            InputError: if it is no id.
        """
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        with self._lock:
            gone = self._idle(time.monotonic(), id)
            known = self._all.pop(id, None)
            if known is None:
                os.makedirs(self._root.name, mode=0o700, exist_ok=True)  # somebody may have cleaned up
            session = known or Session(Path(tempfile.mkdtemp(dir=self._root.name)), self._rig)
            if known is None:
                session.lock.acquire()  # who asks for it next waits for its recordings, who asks for another does not
            self._all[id] = session  # the one used last is last
            if len(self._all) > MOST_SESSIONS:
                gone.append(self._all.pop(next(iter(self._all))))
        if known is None:
            try:
                if self._initial:
                    session.act(lambda: session.copy(self._initial))
            finally:
                session.lock.release()
        for other in gone:
            other.end()
        return session

    def _idle(self, now: float, id: str) -> list[Session]:
        """Take out the sessions that nobody has asked for in a long time; the one of an id is asked for now."""
        self._asked = {known: at for known, at in self._asked.items() if known in self._all} | {id: now}
        late = [known for known, at in self._asked.items() if now - at > IDLE and not self._all[known].busy()]
        return [self._all.pop(known) for known in late]

    def close(self) -> None:
        """End all sessions, motors first."""
        with self._lock:
            for session in self._all.values():
                if session.run is not None:
                    session.run.stop()
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._root.cleanup()
