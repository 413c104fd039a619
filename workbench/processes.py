"""Processes that work for a command: an interrupt is the command's alone to answer, and they end when it does.

The keyboard's interrupt goes to every process of a terminal, also to one that still loads its libraries and can only
die of it with a traceback. So a process is begun with the signal blocked, which it keeps; its parent ends it.
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

PROGRESS: list[Any] = []  # in a worker: what its task is doing, and the share that is done


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


def end_with_parent() -> None:
    """End this worker with the process that began it, even if that one is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent,), daemon=True, name="end with the parent").start()


def _exit_after(parent: BaseProcess) -> None:
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
    end_with_parent()
    use_writer(write_option)
    for file in files:
        load_plugin(file)
    for library in libraries:
        import_module(library)
    PROGRESS[:] = progress


@contextmanager
def open_local_workers(count: int) -> Iterator[Executor]:
    """Open processes that know the effects of the users' files, and end at once if this one is interrupted."""
    pool = Pool(count, list_plugins())
    try:
        yield pool
    finally:
        pool.end()
