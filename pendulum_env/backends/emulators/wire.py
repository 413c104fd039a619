"""A serial cable that is not there: a pseudo-terminal, that can be pulled out or damage what passes."""

from __future__ import annotations

import os
import random

CHUNK = 4096  # bytes


class Wire:
    """The drive's end of a pseudo-terminal; `path` is the other one."""

    def __init__(self) -> None:
        try:
            import pty
            import tty
        except ImportError:
            raise OSError("pseudo-terminals are needed, which this system has not: use Linux or macOS") from None
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)  # held open, so that nothing changes when a host comes and goes
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._noise, self._random = 0.0, random.Random(0)

    @property
    def descriptor(self) -> int:
        """To watch; -1 once it is pulled."""
        return self._master

    def read(self) -> bytes:
        """What has come."""
        try:
            return self._damaged(os.read(self._master, CHUNK))
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send, unless nobody takes it."""
        if self._master >= 0:
            try:
                os.write(self._master, self._damaged(data))
            except BlockingIOError:
                pass  # nobody reads

    def corrupt(self, probability: float) -> None:
        """Each bit is wrong with a probability."""
        self._noise = probability

    def pull(self) -> None:
        """Pull the cable out; may be called twice."""
        for end in (self._master, self._slave):
            if end >= 0:
                os.close(end)
        self._master = self._slave = -1

    def _damaged(self, data: bytes) -> bytes:
        if not self._noise:
            return data
        flips = (sum((self._random.random() < self._noise) << bit for bit in range(8)) for _ in data)
        return bytes(byte ^ flip for byte, flip in zip(data, flips, strict=True))
