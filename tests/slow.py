"""What `make test` leaves to `make test-slow`."""

from collections.abc import Iterable
from typing import Any

import pytest


def but(quick: Iterable[Any], values: Iterable[Any]) -> list[Any]:
    """Values of a parametrised test, or tuples of them; `make test` tries only the quick ones."""
    always = list(quick)
    several = (value if isinstance(value, tuple) else (value,) for value in values)
    return [
        pytest.param(*some, marks=[] if some in always or some[0] in always else pytest.mark.slow) for some in several
    ]


def but_first(values: Iterable[Any]) -> list[Any]:
    """The same, where the first is the quick one."""
    first, *others = values
    return but([first], [first, *others])
