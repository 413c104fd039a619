"""The serial cable, a pseudo-terminal, that can be pulled out."""

import os
from collections.abc import Callable
from contextlib import suppress


class Wire:
    """End of a pseudo-terminal at the drive.

    Attributes:
        place: path of the other end.
        descriptor: to watch; -1 once the cable is pulled.
    """

    chunk = 4096  # bytes that are taken at once

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        """Take what a drive answers to the bytes that come."""
        try:
            import pty
            import tty
        except ImportError:
            raise OSError("pseudo-terminals are needed, which this system has not: use Linux or macOS") from None
        self._answer = answer
        self.descriptor, self._slave = pty.openpty()
        tty.setraw(self._slave)  # held open, so that nothing changes when a host comes and goes
        os.set_blocking(self.descriptor, False)
        self.place = os.ttyname(self._slave)

    def receive(self) -> None:
        """Read the received bytes, and answer."""
        with suppress(BlockingIOError):  # no data, or no reader
            if answer := self._answer(os.read(self.descriptor, self.chunk)):
                os.write(self.descriptor, answer)

    def pull(self) -> None:
        """Pull the cable out; may be called twice."""
        for end in (self.descriptor, self._slave):
            if end >= 0:
                os.close(end)
        self.descriptor = self._slave = -1
