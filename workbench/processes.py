"""Processes that work for a command: an interrupt is the command's alone to answer, and they end when it does.

The keyboard's interrupt goes to every process of a terminal, also to one that still loads its libraries and can only
die of it with a traceback. So a worker is begun with the signal blocked, which it keeps; whoever began it ends it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess

from pendulum_env.reading import LIMITS


@contextmanager
def interrupts_wait() -> Iterator[None]:
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


class Quiet(SpawnProcess):
    """A process that hears of no interrupt."""

    def start(self) -> None:
        """Begin, in a new interpreter: a copy of a process with threads would be unsound."""
        with LIMITS, interrupts_wait():
            super().start()


class QuietContext(SpawnContext):
    """Where a pool of workers takes its processes from."""

    Process = Quiet


def attend() -> None:
    """Called by a worker first: it ends with whoever began it, even if that one is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True, name="end with the parent").start()


def _follow(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)


def end_workers() -> None:
    """End all that this process has begun, whatever they do."""
    workers = [child for child in multiprocessing.active_children() if isinstance(child, Quiet)]
    for worker in workers:
        worker.terminate()
    for worker in workers:
        worker.join()
