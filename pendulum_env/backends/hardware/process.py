"""The process that runs a rig: the signals that end it, its priority, and that it is the only one.

Python runs neither `atexit` nor `finally` on SIGTERM and SIGHUP as they are; here they become SystemExit, which does.
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

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # the last one is unknown to Windows


class Signals:
    """Signals of the system: a function runs first, then the default action."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        """Take what stops the motor; it is told the signal's name and must be safe to call at any time."""
        self._stop = stop
        self._before: dict[int, Any] = {}
        self._held: list[int] = []
        self._depth = 0

    def install(self) -> None:
        """Begin to listen; only the main thread can, another thread leaves it to the main thread."""
        if self._before or threading.current_thread() is not threading.main_thread():
            return
        for name in NAMES:
            number = getattr(signal, name, None)
            if number is None or signal.getsignal(number) in (signal.SIG_IGN, None):
                continue  # None: set by a library in C, which Python could not restore
            self._before[number] = signal.signal(number, self._handle)

    def restore(self) -> None:
        """Stop listening; a handler that was set since then stays, and may go on to call this one."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number, before in list(self._before.items()):
            if signal.getsignal(number) == self._handle:
                signal.signal(number, before)
                del self._before[number]

    def __enter__(self) -> None:
        """Delay signals until the current frame has been sent to the drive."""
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        while self._depth == 0 and self._held:
            self._handle(self._held.pop(0), None)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._depth:
            self._held.append(number)
            return
        with self:  # a second signal waits until the motor has been stopped
            self._stop(signal.Signals(number).name)
        if threading.current_thread() is not threading.main_thread():
            signal.raise_signal(number)  # it came while another thread spoke to the drive; the main one is meant
            return
        before = self._before.get(number, signal.SIG_DFL)
        if callable(before):
            before(number, frame)
        else:
            raise SystemExit(128 + number)


class Ownership:
    """Lock on a name for one process at a time; the system releases it at any end of that process.

    The file lies in the folder for temporary files that all users share, as a motor has one owner among all users.
    Links in its place are not followed, and nothing is read from the file or written to it.
    """

    def __init__(self, what: str) -> None:
        """Take the name of what is owned, such as `serial /dev/ttyACM0`."""
        self.what = what
        digest = hashlib.sha256(what.encode()).hexdigest()[:16]
        self._path = Path(tempfile.gettempdir()) / f"pendulum-ident-{digest}.lock"
        # any user may be the next owner, and any thread may release it
        self._lock = FileLock(self._path, timeout=0, mode=0o666, thread_local=False)

    def acquire(self) -> None:
        """Acquire the rig, unless another process owns it.

        Raises:
            DriveError: if another rig owns it, or its lock cannot be opened.
        """
        if self._lock.is_locked:
            return
        try:
            self._lock.acquire()
        except Timeout:
            raise DriveError(
                f"{self.what} is in use by another program: close its environment, or end it, first (`fuser "
                f"{self._path}` tells its number)"
            ) from None
        except OSError as error:
            raise DriveError(
                f"{self.what} cannot be locked: {self._path}: {error.strerror}: find out who put something else in the "
                "place of this lock, and remove it"
            ) from None

    def release(self) -> None:
        """Let go; may be called twice."""
        self._lock.release(force=True)


def request_realtime() -> bool:
    """Ask the system to run this thread, and those it starts, as soon as they are ready; False if it does not."""
    priority = 20  # above all that is not real-time, below the kernel's own threads
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError):  # not Linux, or not permitted
        return False
    return True


def restore_priority() -> None:
    """Give real-time priority back."""
    with suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
