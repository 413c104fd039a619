"""Signals that end a process: the torque is taken away before they do what they are for.

Python runs neither `atexit` nor `finally` on SIGTERM and SIGHUP as they are; here they become SystemExit, which does.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # the last one is unknown to Windows


class Signals:
    """Calls a function first when a signal comes, then does what would have been done without."""

    def __init__(self, stop: Callable[[str], None]) -> None:
        """Take what stops the motor; it is told the signal's name and must be safe to call at any time."""
        self._stop = stop
        self._before: dict[int, Any] = {}
        self._held: list[int] = []
        self._depth = 0

    def install(self) -> None:
        """Begin to listen; only the main thread can, in another one it is left to whoever owns the main thread."""
        if self._before or threading.current_thread() is not threading.main_thread():
            return
        for name in NAMES:
            number = getattr(signal, name, None)
            if number is None or signal.getsignal(number) in (signal.SIG_IGN, None):
                continue  # None: set by a library in C, which Python could not restore
            self._before[number] = signal.signal(number, self._handle)

    def restore(self) -> None:
        """Stop listening; a handler that somebody set since then stays, and may go on to call this one."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number, before in list(self._before.items()):
            if signal.getsignal(number) == self._handle:
                signal.signal(number, before)
                del self._before[number]

    def __enter__(self) -> None:
        """A signal waits until what is being sent to the drive has been sent: half a frame would be lost."""
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
