"""Cancellable tasks in worker processes, with progress."""

from __future__ import annotations

import json
import multiprocessing
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Future
from contextlib import suppress
from pathlib import Path
from typing import Any

from estimators.diagnosis.cases import list_cases
from estimators.progress import Progress, Screened
from pendulum_env.physics.plugin import describe_fault, list_plugins, load_plugin
from workbench.errors import USER_ERRORS, InputError, format_mistake
from workbench.processes import PROGRESS, Pool

LOST = "the work ended unexpectedly: try again"
# Imported before a task comes
LIBRARIES: tuple[str, ...] = ("pendulum_env.physics.compiled", "estimators.diagnosis.addition", "scipy.signal")
Task = Callable[[Progress], Any]  # function and result must be picklable


class Worker(Pool):
    """Process with loaded libraries, for one task at a time."""

    def __init__(self) -> None:
        """Start the process, and load its libraries and the installed kinds of machines."""
        # progress: current step and errors of the screened effects as JSON, completed share
        self.what, self.share = multiprocessing.RawArray("c", 8000), multiprocessing.RawValue("d")
        super().__init__(1, (), LIBRARIES, self.what, self.share)
        self.submit(_load_cases)


class Workers:
    """Supply of workers with one spare worker, which has loaded its libraries."""

    def __init__(self) -> None:
        """Create an empty supply."""
        self._spare: Worker | None = None
        self._closed, self._lock = False, threading.Lock()

    def start_spare(self) -> None:
        """Start the spare worker, unless it exists."""
        with self._lock:
            if self._spare is None and not self._closed:
                self._spare = Worker()

    def start(self, task: Task) -> tuple[Worker, Future[Any]]:
        """Start a task in the spare worker, or else in a new one; return worker and future."""
        with self._lock:
            worker, self._spare = self._spare or Worker(), None
        try:
            return worker, worker.submit(_run_task, task, list_plugins())
        except BrokenExecutor:  # the spare worker died
            return self.start(task)

    def take_back(self, worker: Worker) -> None:
        """Keep a worker whose task has ended as the spare worker, or end it if there is one."""
        with self._lock:
            keeps = self._spare is None and not self._closed
            self._spare = worker if keeps else self._spare
        if not keeps:
            worker.end()

    def close(self) -> None:
        """End the spare worker; `start_spare` starts no other."""
        with self._lock:
            self._closed = True
            if self._spare is not None:
                self._spare.end()
            self._spare = None


class Job:
    """Running task in a worker process."""

    def __init__(self, title: str, task: Task, workers: Workers) -> None:
        """Start the task in one of the workers."""
        self.title = title  # heading of the progress bar
        self.running, self.over = True, threading.Event()  # `over` is set when the task has ended or is cancelled
        self._began, self._workers = time.monotonic(), workers
        self._worker, self._future = workers.start(task)
        self._said: tuple[str, dict[str, float]] = "starting", {}

    def call_at_end(self, ended: Callable[[Job], None]) -> None:
        """Register a function to call at the end of the task, unless the task is cancelled."""
        self._future.add_done_callback(lambda _: self._end(ended))

    @property
    def progress(self) -> tuple[str, dict[str, float]]:
        """Return the current step of the task, and the error with each effect that was screened, by id."""
        with suppress(ValueError):  # the worker is writing
            self._said = json.loads(self._worker.what.value)
        return self._said

    @property
    def share(self) -> float:
        """Return the completed share, 0 to 1."""
        return float(self._worker.share.value)

    @property
    def elapsed(self) -> float:
        """Return the elapsed time [s]."""
        return time.monotonic() - self._began

    @property
    def result(self) -> Any:
        """Return the result; raises InputError if the task failed."""
        error = self._future.exception()
        if error is None:
            return self._future.result()
        if isinstance(error, InputError):
            raise error
        traceback.print_exception(error)  # a bug, or the process was killed
        raise InputError(LOST)

    def cancel(self) -> None:
        """Cancel the task and discard its result."""
        self.running = False
        self._worker.end()
        self._workers.start_spare()
        self.over.set()

    def _end(self, ended: Callable[[Job], None]) -> None:
        if not self.running:
            return
        self._workers.take_back(self._worker)  # `ended` may start the next task in it
        try:
            ended(self)
        finally:
            self.running = False
            self.over.set()


def _load_cases() -> None:
    list_cases()


def _run_task(task: Task, files: Sequence[Path]) -> Any:
    """Load the effect files of the parent process and run a task; users' errors become InputError."""
    errors = dict[str, float]()

    def set_progress(text: str, completed: float) -> None:
        if isinstance(text, Screened):
            errors.setdefault(text.effect, text.error)  # of the first round, in which all effects compete
        step, share = PROGRESS
        step.value, share.value = json.dumps([text, errors]).encode(), completed

    try:
        for file in files:
            load_plugin(file)
        set_progress("starting", 0.0)
        return task(set_progress)
    except BaseException as error:
        mistake = error if isinstance(error, USER_ERRORS) else describe_fault(error)
        if mistake is None:
            raise
        raise InputError(format_mistake(mistake)) from None
