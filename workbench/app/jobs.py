"""Long work in processes of their own: it can be watched and cancelled, and no session waits for another's."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from estimators.progress import Progress
from pendulum_env.physics import load_plugin
from pendulum_env.physics.plugin import plugins
from workbench.mistakes import MISTAKES, sentence
from workbench.processes import Quiet, attend

Task = Callable[[Progress], Any]  # what a worker does; it travels to another process, and so does what it returns

PROGRESS, DONE, FAILED = "progress", "done", "failed"  # what a worker says
LOST = (FAILED, "the work ended unexpectedly: try again")  # what it says if it cannot
SURE = 0.08  # share of the work before which the time left is anyone's guess


class Pace:
    """What is being done, how much of it is done, and how long the rest may take."""

    def __init__(self) -> None:
        """Start the clock."""
        self.began = time.monotonic()
        self.what, self.share = "starting", 0.0

    def tell(self, what: str, share: float) -> None:
        """Take in what is being done and the share of the work that is done."""
        self.what, self.share = what, max(self.share, min(share, 1.0))

    @property
    def elapsed(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.began

    @property
    def left(self) -> float | None:
        """Seconds that the work will take at this pace; None while nobody can tell."""
        return self.elapsed * (1.0 - self.share) / self.share if self.share > SURE else None


class Worker:
    """A process that waits for tasks; its libraries are loaded while it waits."""

    def __init__(self) -> None:
        """Start the process."""
        self.connection, theirs = multiprocessing.Pipe()
        self._process = Quiet(target=_work, args=(theirs, plugins()), daemon=True, name="pendulum-ident worker")
        self._process.start()
        theirs.close()

    @property
    def alive(self) -> bool:
        """Whether the process is there."""
        return self._process.is_alive()

    def end(self) -> None:
        """End the process, whatever it does."""
        self._process.terminate()
        self._process.join()
        self.connection.close()


class Workers:
    """Keeps one worker ready, so that short work need not wait for the libraries."""

    def __init__(self) -> None:
        """Start none yet."""
        self._spare: Worker | None = None
        self._lock = Lock()

    def warm(self) -> None:
        """See to it that a worker waits."""
        with self._lock:
            self._spare = self._spare or Worker()

    def take(self) -> Worker:
        """The worker that waits, or a new one."""
        with self._lock:
            worker, self._spare = self._spare, None
        return worker if worker is not None and worker.alive else Worker()

    def give_back(self, worker: Worker) -> None:
        """Let a worker wait for the next task, unless one waits already."""
        with self._lock:
            if self._spare is None:
                self._spare = worker
                return
        worker.end()

    def close(self) -> None:
        """End the one that waits."""
        with self._lock:
            if self._spare is not None:
                self._spare.end()
            self._spare = None


class Job:
    """One task in a worker.

    Attributes:
        title: what it does, as a heading.
        pace: how far it is.
        running: whether it is on its way.
        over: set once nothing more comes of it.
    """

    def __init__(
        self,
        title: str,
        task: Task,
        workers: Workers,
        done: Callable[[Job, Any], None],
        failed: Callable[[Job, str], None],
    ) -> None:
        """Take the task, who does it, and what to do with its result or with a sentence that says why there is none."""
        self.title, self.pace, self.running, self.over = title, Pace(), True, Event()
        self._task, self._workers, self._done, self._failed = task, workers, done, failed
        self._worker: Worker | None = None
        self._cancelled = False
        self._lock = Lock()

    def start(self) -> None:
        """Begin, and return at once."""
        self._worker = self._workers.take()
        with suppress(OSError):  # it has died since: who listens is told
            self._worker.connection.send(self._task)
        Thread(target=self._listen, args=(self._worker,), daemon=True, name=self.title).start()

    def cancel(self) -> None:
        """Stop at once; nothing comes of it."""
        with self._lock:
            worker, self._worker = self._worker, None
            self.running, self._cancelled = False, True
        self.over.set()
        if worker is not None:
            worker.end()
            self._workers.warm()

    def _listen(self, worker: Worker) -> None:
        kind, content = LOST
        with suppress(EOFError, OSError):  # a worker that dies, or is ended, closes its end
            while True:
                kind, content = worker.connection.recv()
                if kind != PROGRESS:
                    break
                self.pace.tell(*content)
                kind, content = LOST
        with self._lock:
            if self._cancelled:
                return
            self._worker = None  # from now on it cannot be cancelled
        if (kind, content) == LOST:
            worker.end()
        else:
            self._workers.give_back(worker)
        try:
            if kind == DONE:
                self._done(self, content)
            else:
                self._failed(self, content)
        finally:
            self.running = False
            self.over.set()


def _work(connection: Connection[Any, Any], files: Sequence[Path]) -> None:
    """Do tasks as they come, in a process of its own."""
    attend()
    from workbench import cli  # noqa: F401  (these take a while: before the first task comes)
    from workbench.app import tasks  # noqa: F401

    with suppress(EOFError, OSError):
        while True:
            task: Task = connection.recv()
            try:
                for file in files:  # each is run once; one that has gone since is told of like any mistake
                    load_plugin(file)
                connection.send((DONE, task(lambda what, share: connection.send((PROGRESS, (what, share))))))
            except MISTAKES as mistake:
                connection.send((FAILED, sentence(mistake)))
