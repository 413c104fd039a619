"""Jobs of the app: tasks in worker processes, with progress, which can be cancelled."""

from __future__ import annotations

import multiprocessing
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

from estimators.progress import Progress
from pendulum_env.physics.plugin import describe_fault, list_plugins, load_plugin
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.processes import PROGRESS, Pool

LOST = "the work ended unexpectedly: try again"
LIBRARIES: tuple[str, ...] = ("estimators.diagnosis.addition", "pendulum_env.backends.simulated")  # of most tasks
Task = Callable[[Progress], Any]  # of the app; it travels to another process, and so does what it returns


class Worker(Pool):
    """A process that waits for a task with its libraries loaded."""

    def __init__(self) -> None:
        """Start the process."""
        self.what, self.share = multiprocessing.RawArray("c", 200), multiprocessing.RawValue("d")  # of the task
        super().__init__(1, (), LIBRARIES, self.what, self.share)
        self.submit(int)


class Workers:
    """Keeps one worker ready, so that short work need not wait for the libraries."""

    def __init__(self) -> None:
        """Start none yet."""
        self._spare: Worker | None = None
        self._closed, self._lock = False, threading.Lock()

    def warm(self) -> None:
        """See to it that a worker waits."""
        with self._lock:
            if self._spare is None and not self._closed:
                self._spare = Worker()

    def start(self, task: Task) -> tuple[Worker, Future[Any]]:
        """Start a task in the worker that waits, or in a new one."""
        with self._lock:
            worker, self._spare = self._spare or Worker(), None
        try:
            return worker, worker.submit(_do, task, list_plugins())
        except BrokenExecutor:  # it died while it waited, and now none does
            return self.start(task)

    def close(self) -> None:
        """End the one that waits; no other will."""
        with self._lock:
            self._closed = True
            if self._spare is not None:
                self._spare.end()
            self._spare = None


class Job:
    """Task in a worker process, which starts immediately."""

    def __init__(self, title: str, task: Task, workers: Workers) -> None:
        """Take the task, and who does it."""
        self.title = title  # what it does, as a heading
        self.running, self.over = True, threading.Event()  # on its way; set once nothing more comes of it
        self._began, self._workers = time.monotonic(), workers
        self._worker, self._future = workers.start(task)

    def call_at_end(self, ended: Callable[[Job], None]) -> None:
        """Call a function at the end of the task, unless it is cancelled."""
        self._future.add_done_callback(lambda _: self._end(ended))

    @property
    def description(self) -> str:
        """Return what is being done."""
        return self._worker.what.value.decode(errors="ignore") or "starting"

    @property
    def share(self) -> float:
        """Return the share of all that is done."""
        return float(self._worker.share.value)

    @property
    def elapsed(self) -> float:
        """Return the elapsed time [s]."""
        return time.monotonic() - self._began

    @property
    def result(self) -> Any:
        """Return the result; raises InputError if there is none."""
        error = self._future.exception()
        if error is None:
            return self._future.result()
        if isinstance(error, InputError):
            raise error
        traceback.print_exception(error)  # a fault of the program, or the process was killed
        raise InputError(LOST)

    def cancel(self) -> None:
        """Stop at once; nothing comes of it."""
        self.running = False
        self._close()

    def _end(self, ended: Callable[[Job], None]) -> None:
        try:
            if self.running:
                ended(self)
        finally:
            self.running = False
            self._close()

    def _close(self) -> None:
        self._worker.end()
        self._workers.warm()
        self.over.set()


def _do(task: Task, files: Sequence[Path]) -> Any:
    """Do a task, with the users' effects that are known to the process that asks for it."""
    try:
        for file in files:
            load_plugin(file)
        return task(_set_progress)
    except BaseException as error:
        mistake = error if isinstance(error, USER_ERRORS) else describe_fault(error)
        if mistake is None:
            raise
        raise InputError(format_mistake(mistake)) from None


def _set_progress(text: str, done: float) -> None:
    what, share = PROGRESS
    what.value, share.value = text.encode()[:199], done
