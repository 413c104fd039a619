"""All sessions of a server, each apart from all others."""

from __future__ import annotations

import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from secrets import token_hex
from threading import RLock

from pendulum_env.recording import Source
from workbench.app.jobs import Workers
from workbench.app.session import Session
from workbench.mistakes import InputError
from workbench.robot import RobotFile

ID = re.compile(r"[0-9a-f]{32}")  # random, drawn by the page; never part of a path
MOST_SESSIONS = 16  # the one that was used least recently gives way
IDLE = 12 * 3600.0  # [s] after which a session that nobody has asked for ends


class Sessions:
    """All sessions of a server by the id that each page holds, and the workers that they share."""

    def __init__(
        self, recordings: Sequence[Source] = (), rig: Path | None = None, robot: RobotFile | None = None
    ) -> None:
        """Make a folder for their folders; every session begins with the recordings, and may run the rig."""
        self._initial, self._rig, self._robot = tuple(recordings), rig, robot
        self.workers = Workers()
        self._root = tempfile.TemporaryDirectory(prefix="pendulum-ident-", ignore_cleanup_errors=True)
        self._all: dict[str, Session] = {}  # the one used last is last
        self._lock = RLock()

    def of(self, id: object) -> Session:
        """Session of an id, a new one if there is none.

        Raises:
            InputError: if it is no id.
        """
        if not isinstance(id, str) or ID.fullmatch(id) is None:
            raise InputError("this page has no session: load it again")
        now = time.monotonic()
        with self._lock:
            session = self._all.pop(id, None)
            late = [k for k, other in self._all.items() if now - other.asked > IDLE and not other.busy()]
            ended = [self._all.pop(k) for k in late]
            is_new = session is None
            if session is None:
                session = Session(Path(self._root.name) / token_hex(8), self.workers, self._rig)
                session.lock.acquire()  # who asks for it next waits for its recordings, who asks for another does not
            session.asked = now
            self._all[id] = session
            if len(self._all) > MOST_SESSIONS:
                ended.append(self._all.pop(next(iter(self._all))))
        if is_new:
            try:
                if self._robot is not None:
                    robot = self._robot
                    session.act(lambda: session.take_robot(robot))
                if self._initial:
                    session.act(lambda: session.load(self._initial))
            finally:
                session.lock.release()
        for other in ended:
            other.end()
        return session

    def close(self) -> None:
        """End all sessions, motors first, and the workers."""
        with self._lock:
            for session in self._all.values():
                if session.run is not None:
                    session.run.stop()
            for session in self._all.values():
                session.end()
            self._all.clear()
            self._root.cleanup()
        self.workers.close()
