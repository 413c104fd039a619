"""The serial cable, a pseudo-terminal, that can be pulled out or damage what passes."""

import os
import random
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
        self._noise, self._random = 0.0, random.Random(0)

    def receive(self) -> None:
        """Read the received bytes, and answer."""
        with suppress(BlockingIOError):  # no data, or no reader
            if answer := self._answer(self._flip_bits(os.read(self.descriptor, self.chunk))):
                os.write(self.descriptor, self._flip_bits(answer))

    def corrupt(self, probability: float) -> None:
        """Flip each bit with a probability."""
        self._noise = probability

    def pull(self) -> None:
        """Pull the cable out; may be called twice."""
        for end in (self.descriptor, self._slave):
            if end >= 0:
                os.close(end)
        self.descriptor = self._slave = -1

    def _flip_bits(self, data: bytes) -> bytes:
        if not self._noise:
            return data
        flips = (sum((self._random.random() < self._noise) << bit for bit in range(8)) for _ in data)
        return bytes(byte ^ flip for byte, flip in zip(data, flips, strict=True))
