"""Processes that work for a command: an interrupt is the command's alone to answer, and they end when it does.

The keyboard's interrupt goes to every process of a terminal, also to one that still loads its libraries and can only
die of it with a traceback. So a process is begun with the signal blocked, which it keeps; its parent ends it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from estimators.progress import Progress
from pendulum_env.physics import load_plugin
from pendulum_env.physics.plugin import describe_fault, list_plugins
from pendulum_env.settings import use_writer
from workbench.errors import USER_ERRORS, InputError, format_mistake, write_option

LOST = "the work ended unexpectedly: try again"
LIBRARIES: tuple[str, ...] = (
    "workbench.cli",
    "workbench.commands.record",
    "estimators.diagnosis.addition",
)  # of the tasks of the app
_progress: list[Any] = []  # in a worker: what its task is doing, and the share that is done

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


class Pool(ProcessPoolExecutor):
    """Processes on this computer that never receive an interrupt, and end with this one."""

    def __init__(self, count: int, files: Sequence[Path] = (), libraries: Sequence[str] = (), *progress: Any) -> None:
        """Take the number of processes, what each loads, and the memory where it tells its progress."""
        context = multiprocessing.get_context("spawn")  # a copy of a process with threads would be unsound
        super().__init__(count, context, _prepare, (files, libraries, progress))

    def submit(self, task: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Schedule a task; processes start here."""
        with hold_interrupts():
            return super().submit(task, *args, **kwargs)

    def end(self) -> None:
        """End the processes, whatever they do."""
        processes = [*(self._processes or {}).values()]
        self.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()


def _prepare(files: Sequence[Path], libraries: Sequence[str], progress: Sequence[Any]) -> None:
    attend()
    use_writer(write_option)
    for file in files:
        load_plugin(file)
    for library in libraries:
        import_module(library)
    _progress[:] = progress


@contextmanager
def open_local_workers(count: int) -> Iterator[Executor]:
    """Open processes that know the effects of the users' files, and end at once if this one is interrupted."""
    pool = Pool(count, list_plugins())
    try:
        yield pool
    finally:
        pool.end()


class Worker:
    """A process that waits for a task with its libraries loaded."""

    def __init__(self) -> None:
        """Start the process."""
        self.what, self.share = multiprocessing.RawArray("c", 200), multiprocessing.RawValue("d")  # of the task
        self.pool = Pool(1, (), LIBRARIES, self.what, self.share)
        self.pool.submit(int)


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
            return worker, worker.pool.submit(_do, task, list_plugins())
        except BrokenExecutor:  # it died while it waited, and now none does
            return self.start(task)

    def close(self) -> None:
        """End the one that waits; no other will."""
        with self._lock:
            self._closed = True
            if self._spare is not None:
                self._spare.pool.end()
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
    def what(self) -> str:
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
        self._worker.pool.end()
        self._workers.warm()
        self.over.set()


def _do(task: Task, files: Sequence[Path]) -> Any:
    """Do a task, with the users' effects that are known to the process that asks for it."""
    try:
        for file in files:
            load_plugin(file)
        return task(_tell)
    except BaseException as error:
        mistake = error if isinstance(error, USER_ERRORS) else describe_fault(error)
        if mistake is None:
            raise
        raise InputError(format_mistake(mistake)) from None


def _tell(text: str, done: float) -> None:
    what, share = _progress
    what.value, share.value = text.encode()[:199], done
