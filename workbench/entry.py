"""Entry point of the console script, which handles an interrupt while the libraries load."""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn


def main() -> int:
    """Run the command line and return the exit code."""
    try:
        _open_streams()
        _end_in_order()
        from workbench.cli import main as run  # slow: loads the libraries

        return run()
    except KeyboardInterrupt:
        print("pendulum-ident: interrupted", file=sys.stderr)
        return 130


def _open_streams() -> None:
    """Open os.devnull for standard streams that are closed, so that no other file gets their descriptors."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))


def _end_in_order() -> None:
    """Convert SIGTERM and SIGHUP to SystemExit, so that workers end and partial files are deleted."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP; nohup ignores it
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _end)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    raise SystemExit(128 + number)


if __name__ == "__main__":
    raise SystemExit(main())
