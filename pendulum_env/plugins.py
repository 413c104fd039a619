"""Objects of installed packages, by groups of entry points."""

import warnings
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from pendulum_env.errors import format_error


@cache
def load_plugins(group: str) -> tuple[Any, ...]:
    """Load the objects of a group of entry points, each once; warn of those that fail.

    A module as an object registers its content when it is imported.
    """
    loaded = []
    for point in entry_points(group=group):
        try:
            loaded.append(point.load())
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also SystemExit of another package
            warnings.warn(f"'{point.value}' of {group} cannot be loaded: {format_error(error)}", stacklevel=3)
    return tuple(loaded)
