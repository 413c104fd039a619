"""Entry point of the console script, which handles an interrupt while the libraries load."""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn


def main() -> int:
    """Run the command line; returns the exit code."""
    try:
        _open_streams()
        _end_in_order()
        from workbench.cli import main as run  # takes a while

        return run()
    except KeyboardInterrupt:
        print("pendulum-ident: interrupted", file=sys.stderr)
        return 130


def _open_streams() -> None:
    """Replace standard streams that were closed, as with `>&-`, so that no opened file takes their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # takes the lowest number that is free


def _end_in_order() -> None:
    """Let a request to end run what has to be done before, as an interrupt does: workers end, half a file goes away."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # the second is unknown to Windows, and ignored under nohup
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _end)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)
