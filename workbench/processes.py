"""Worker processes of a command, which ignore interrupts and end with the command.

A terminal sends SIGINT to all its processes. Workers start with the signal blocked, because during their imports it
would print a traceback; the parent ends them instead.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from pendulum_env.physics import load_plugin
from pendulum_env.physics.plugin import list_plugins
from pendulum_env.settings import use_writer
from workbench.errors import write_option

PROGRESS: list[Any] = []  # in a worker: shared memory for the current step and the completed share


@contextmanager
def hold_interrupts() -> Iterator[None]:
    """Delay interrupts until the block ends; processes started inside it keep the signal blocked."""
    if os.name == "posix":
        resource_tracker.ensure_running()  # its start inside the block would unblock the signal
    is_main = threading.current_thread() is threading.main_thread()  # Python handles signals only in the main thread
    received: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, frame: received.append(number)) if is_main else None
    block = getattr(signal, "pthread_sigmask", None)  # missing on Windows
    mask = block(signal.SIG_BLOCK, {signal.SIGINT}) if block is not None else None
    try:
        yield
    finally:
        if block is not None:
            block(signal.SIG_SETMASK, mask)
        if is_main:
            signal.signal(signal.SIGINT, previous)
            if received:
                signal.raise_signal(signal.SIGINT)


def end_with_parent() -> None:
    """End this worker when its parent ends, even if the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent,), daemon=True, name="end with the parent").start()


def _exit_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


class Pool(ProcessPoolExecutor):
    """Pool of local processes that ignore interrupts and end with this process."""

    def __init__(self, count: int, files: Sequence[Path] = (), libraries: Sequence[str] = (), *progress: Any) -> None:
        """Set the number of processes, the effect files and libraries that each loads, and its `PROGRESS`."""
        context = multiprocessing.get_context("spawn")  # fork is unsafe with threads
        super().__init__(count, context, _prepare, (files, libraries, progress))

    def submit(self, task: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Submit a task, and start processes if needed."""
        with hold_interrupts():
            return super().submit(task, *args, **kwargs)

    def end(self) -> None:
        """Terminate the processes and cancel waiting tasks."""
        processes = [*(self._processes or {}).values()]
        self.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()


def _prepare(files: Sequence[Path], libraries: Sequence[str], progress: Sequence[Any]) -> None:
    end_with_parent()
    use_writer(write_option)
    for file in files:
        load_plugin(file)
    for library in libraries:
        import_module(library)
    PROGRESS[:] = progress


@contextmanager
def open_local_workers(count: int) -> Iterator[Executor]:
    """Open a pool of processes with the loaded effect files; it is terminated on exit."""
    pool = Pool(count, list_plugins())
    try:
        yield pool
    finally:
        pool.end()
