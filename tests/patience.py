"""Waiting in tests: for as long as it takes, so that a busy machine is no mistake, and not for ever."""

import time
from collections.abc import Callable

PATIENCE = 300.0  # [s]: what has not come by then hangs


def wait_until(so: Callable[[], object], why: Callable[[], str] = lambda: "it does not come") -> None:
    """Wait until something is so; raises AssertionError, with what there is instead, if that hangs."""
    until = time.monotonic() + PATIENCE
    while not so():
        assert time.monotonic() < until, why()
        time.sleep(0.02)
