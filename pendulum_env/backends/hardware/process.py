"""Signals, priority and lock of the process that runs a rig.

On SIGTERM and SIGHUP, Python runs neither `atexit` nor `finally`. Here these signals raise SystemExit, which does.
"""

import hashlib
import os
import signal
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

from filelock import FileLock, Timeout

from pendulum_env.backends.hardware import DriveError

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # Windows lacks SIGHUP


class Signals:
    """Handler of signals that calls a function before the default action."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        """Set the function that stops the motor, called with the signal's name at any time."""
        self._stop = stop
        self._previous: dict[int, Any] = {}
        self._delayed: list[int] = []
        self._depth = 0

    def install(self) -> None:
        """Install the handlers; has no effect outside the main thread."""
        if self._previous or threading.current_thread() is not threading.main_thread():
            return
        for name in NAMES:
            number = getattr(signal, name, None)
            if number is None or signal.getsignal(number) in (signal.SIG_IGN, None):
                continue  # None: a handler in C, which Python cannot restore
            self._previous[number] = signal.signal(number, self._handle)

    def restore(self) -> None:
        """Restore the previous handlers, except where another handler was set since."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number, previous in list(self._previous.items()):
            if signal.getsignal(number) == self._handle:
                signal.signal(number, previous)
                del self._previous[number]

    def __enter__(self) -> None:
        """Delay signals until the end of the context."""
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        while self._depth == 0 and self._delayed:
            self._handle(self._delayed.pop(0), None)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._depth:
            self._delayed.append(number)
            return
        with self:  # delays a second signal
            self._stop(signal.Signals(number).name)
        if threading.current_thread() is not threading.main_thread():
            signal.raise_signal(number)  # delayed by another thread: raise it again in the main thread
            return
        previous = self._previous.get(number, signal.SIG_DFL)
        if callable(previous):
            previous(number, frame)
        else:
            raise SystemExit(128 + number)


class DeviceLock:
    """Lock on a name for one process at a time, released by the system when the process ends.

    The lock file is in the shared folder of temporary files, because the lock holds for all users. Links are not
    followed, and the file stays empty.
    """

    def __init__(self, device: str) -> None:
        """Set the name of the device, for example `serial /dev/ttyACM0`."""
        self.device = device
        digest = hashlib.sha256(device.encode()).hexdigest()[:16]
        self._path = Path(tempfile.gettempdir()) / f"pendulum-ident-{digest}.lock"
        # any user may lock it next, and any thread may release it
        self._lock = FileLock(self._path, timeout=0, mode=0o666, thread_local=False)

    def acquire(self) -> None:
        """Acquire the lock; raises DriveError if another process holds the lock, or it cannot be opened."""
        if self._lock.is_locked:
            return
        try:
            self._lock.acquire()
        except Timeout:
            raise DriveError(
                f"{self.device} is in use by another program: close its environment, or end it, first (`fuser "
                f"{self._path}` tells its number)"
            ) from None
        except OSError as error:
            raise DriveError(
                f"{self.device} cannot be locked: {self._path}: {error.strerror}: find out who put something else in "
                "the place of this lock, and remove it"
            ) from None

    def release(self) -> None:
        """Release the lock; may be called repeatedly."""
        self._lock.release(force=True)


def request_realtime() -> bool:
    """Request real-time priority for this thread and the threads it starts; return whether it was granted."""
    priority = 20  # above other processes, below threads of the kernel
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):  # not Linux, or not permitted
        return False
    return True


def restore_priority() -> None:
    """Restore normal priority."""
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
