"""Processes that work for a command: an interrupt is the command's alone to answer, and they end when it does.

The keyboard's interrupt goes to every process of a terminal, also to one that still loads its libraries and can only
die of it with a traceback. So a worker is begun with the signal blocked, which it keeps; its parent ends it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from estimators.progress import Progress
from pendulum_env.physics import load_plugin
from pendulum_env.physics.plugin import describe_fault, list_plugins
from pendulum_env.settings import use_writer
from workbench.errors import USER_ERRORS, InputError, format_mistake, write_option

LOST = "the work ended unexpectedly: try again"
LIBRARIES = ("workbench.cli", "workbench.commands.record", "estimators.diagnosis.addition")  # of the tasks of the app


Task = Callable[[Progress], Any]  # of the app; it travels to another process, and so does what it returns


@contextmanager
def hold_interrupts() -> Iterator[None]:
    """Let an interrupt come when what is done here is done; processes that are begun meanwhile never hear of one."""
    if os.name == "posix":
        resource_tracker.ensure_running()  # else it is begun below, and takes the block away
    in_front = threading.current_thread() is threading.main_thread()  # only there Python answers signals
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: came.append(number)) if in_front else None
    block = getattr(signal, "pthread_sigmask", None)  # unknown to Windows
    mask = block(signal.SIG_BLOCK, {signal.SIGINT}) if block is not None else None
    try:
        yield
    finally:
        if block is not None:
            block(signal.SIG_SETMASK, mask)
        if in_front:
            signal.signal(signal.SIGINT, before)
            if came:
                signal.raise_signal(signal.SIGINT)


def attend() -> None:
    """End this worker with the process that began it, even if that one is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True, name="end with the parent").start()


def _follow(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


@dataclass(frozen=True)
class TaskEnd:
    """The last word of a task: what it came to, or a sentence on why that is nothing."""

    came: Any = None
    why: str = ""

    @property
    def result(self) -> Any:
        """Return the result; raises InputError if there is none."""
        if self.why:
            raise InputError(self.why)
        return self.came


class Worker:
    """A process that does one task, at the other end of a pipe; its libraries are loaded while it waits for the task.

    The task is called with its end of the pipe and may talk through it; what it returns, or a user's mistake, is sent
    as `End`. It should call `attend` if nothing has to be brought to an end once this process is killed.
    """

    def __init__(self, name: str, libraries: Sequence[str] = ()) -> None:
        """Start the process."""
        context = multiprocessing.get_context("spawn")  # a copy of a process with threads would be unsound
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs, list_plugins(), libraries), daemon=True, name=name)
        with hold_interrupts():
            self.process.start()
        theirs.close()

    def send(self, message: object) -> None:
        """Give it the task, which travels to it, and then tell that something, if it still listens."""
        with suppress(OSError):
            self.connection.send(message)

    def hear(self) -> Any:
        """Wait for the next message; a `TaskEnd` if the process has died."""
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            return TaskEnd(why=LOST)

    def end(self) -> None:
        """End the process, whatever it does."""
        if self.process.is_alive():
            self.process.terminate()
        self.process.join()
        self.connection.close()


def _work(connection: Connection[Any, Any], files: Sequence[Path], libraries: Sequence[str]) -> None:
    """Do the task that comes, with the users' effects that are known to who began this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_writer(write_option)
    for library in libraries:
        import_module(library)
    with suppress(EOFError, OSError):  # the parent has ended
        try:
            for file in files:
                load_plugin(file)
            word = TaskEnd(connection.recv()(connection))
        except (EOFError, BrokenPipeError):
            return
        except USER_ERRORS as mistake:
            word = TaskEnd(why=format_mistake(mistake))
        except BaseException as error:
            if (of_plugin := describe_fault(error)) is None:
                raise
            word = TaskEnd(why=format_mistake(of_plugin))
        connection.send(word)


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
                self._spare = Worker("pendulum-ident worker", LIBRARIES)

    def take(self) -> Worker:
        """Return the worker that waits, or a new one."""
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
    """Task in a worker process, which starts immediately."""

    def __init__(self, title: str, task: Task, workers: Workers, ended: Callable[[Job, TaskEnd], None]) -> None:
        """Take the task, who does it, and what is told how it ended."""
        self.title = title  # what it does, as a heading
        self.what, self.share = "starting", 0.0  # what is being done, and how much of all is done
        self.running, self.over = True, threading.Event()  # on its way; set once nothing more comes of it
        self._began, self._workers, self._ended = time.monotonic(), workers, ended
        self._worker = workers.take()
        threading.Thread(target=self._listen, args=(task,), daemon=True, name=title).start()

    @property
    def elapsed(self) -> float:
        """Return the elapsed time [s]."""
        return time.monotonic() - self._began

    def cancel(self) -> None:
        """Stop at once; nothing comes of it."""
        self.running = False
        self._worker.process.terminate()  # who listens ends it
        self.over.set()

    def _listen(self, task: Task) -> None:
        self._worker.send(partial(_do, task))  # takes until the worker has its libraries
        while not isinstance(word := self._worker.hear(), TaskEnd):
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


class _LocalPool(ProcessPoolExecutor):
    """Pool whose processes never receive an interrupt."""

    def submit(self, task: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a task; processes start here."""
        with hold_interrupts():
            return super().submit(task, *args, **kwargs)


@contextmanager
def open_local_workers(count: int) -> Iterator[Executor]:
    """Open the processes on this computer, which end with this one, and at once if it is interrupted.

    They know the effects of the users' files.
    """
    others = set(multiprocessing.active_children())
    executor = _LocalPool(count, multiprocessing.get_context("spawn"), _join, (list_plugins(),))
    try:
        yield executor
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()


def _join(files: Sequence[Path]) -> None:
    """Prepare a process of a pool."""
    attend()
    use_writer(write_option)
    for file in files:
        load_plugin(file)
