"""Computations in parts, so that a sample never waits for a whole fit.

A function that yields between its parts is a computation. Parts have a bounded number of operations. How many parts are
computed with a sample does not depend on a clock, so the same samples give the same results.
"""

from collections.abc import Generator
from typing import TypeVar

T = TypeVar("T")
Work = Generator[None, None, T]


def complete(work: Work[T]) -> T:
    """Compute all parts, and return the result."""
    try:
        while True:
            next(work)
    except StopIteration as end:
        result: T = end.value
        return result
