"""Long work in processes of their own: it can be watched and cancelled, and no session waits for another's."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from threading import Event, Lock, Thread
from typing import Any

from estimators.progress import Progress
from workbench.processes import Done, Failed, Worker, attend

Task = Callable[[Progress], Any]  # what a worker does; it travels to another process, and so does what it returns

LIBRARIES = ("workbench.cli", "estimators.diagnosis.addition", "workbench.app.live")  # what tasks need


class Workers:
    """Keeps one worker ready, so that short work need not wait for the libraries."""

    def __init__(self) -> None:
        """Start none yet."""
        self._spare: Worker | None = None
        self._closed, self._lock = False, Lock()

    def warm(self) -> None:
        """See to it that a worker waits."""
        with self._lock:
            if self._spare is None and not self._closed:
                self._spare = Worker("pendulum-ident worker", LIBRARIES)

    def take(self) -> Worker:
        """The worker that waits, or a new one."""
        with self._lock:
            worker, self._spare = self._spare, None
        return worker if worker is not None and worker.process.is_alive() else Worker("pendulum-ident worker")

    def close(self) -> None:
        """End the one that waits; no other will."""
        with self._lock:
            self._closed = True
            if self._spare is not None:
                self._spare.end()
            self._spare = None


class Job:
    """One task in a worker, which begins at once.

    Attributes:
        title: what it does, as a heading.
        what, share: what is being done, and how much of all is done.
        running: whether it is on its way.
        over: set once nothing more comes of it.
    """

    def __init__(self, title: str, task: Task, workers: Workers, ended: Callable[[Job, Done | Failed], None]) -> None:
        """Take the task, who does it, and what is told how it ended."""
        self.title, self.what, self.share, self.running, self.over = title, "starting", 0.0, True, Event()
        self._began, self._workers, self._ended = time.monotonic(), workers, ended
        self._worker = workers.take()
        self._worker.begin(partial(_do, task))
        Thread(target=self._listen, daemon=True, name=title).start()

    @property
    def elapsed(self) -> float:
        """How long it has gone on [s]; how long it will, nobody knows."""
        return time.monotonic() - self._began

    def cancel(self) -> None:
        """Stop at once; nothing comes of it."""
        self.running = False
        self._worker.process.terminate()  # who listens ends it
        self.over.set()

    def _listen(self) -> None:
        while not isinstance(word := self._worker.hear(), Done | Failed):
            self.what, self.share = word
        try:
            if self.running:
                self._ended(self, word)
        finally:
            self.running = False
            self.over.set()
            self._worker.end()
            self._workers.warm()


def _do(task: Task, connection: Connection[Any, Any]) -> Any:
    """Do a task in a process of its own, which tells its progress."""
    attend()
    return task(lambda what, share: connection.send((what, share)))
