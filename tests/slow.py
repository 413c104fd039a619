"""What `make test` leaves to `make test-slow`."""

from collections.abc import Iterable
from typing import Any

import pytest


def but(quick: Iterable[Any], values: Iterable[Any]) -> list[Any]:
    """Values of a parametrised test, or tuples of them; `make test` tries only the quick ones."""
    always, values = list(quick), list(values)
    assert all(value in values for value in always), f"not all of {always} are among the values"
    marked = ((value, () if value in always else pytest.mark.slow) for value in values)
    return [pytest.param(*(own if isinstance(own, tuple) else [own]), marks=marks) for own, marks in marked]


def but_first(values: Iterable[Any]) -> list[Any]:
    """The same, where the first is the quick one."""
    first, *others = values
    return but([first], [first, *others])
