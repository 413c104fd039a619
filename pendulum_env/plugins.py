"""Objects of installed packages, by groups of entry points."""

import warnings
from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from pendulum_env.errors import UserError, format_error

_failures: dict[str, list[str]] = {}  # by group


@cache
def load_plugins(group: str) -> Mapping[str, Any]:
    """Load the objects of a group of entry points, each once, by name; warn of those that fail.

    A module as an object registers its content when it is imported.
    """
    loaded = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        try:
            name = f"{point.name} ({point.value})" if point.name in loaded else point.name
            loaded[name] = point.load()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also SystemExit of another package
            failure = f"'{point.value}' of {group} cannot be loaded: {format_error(error)}"
            _failures.setdefault(group, []).append(failure)
            warnings.warn(failure, stacklevel=3)
    return loaded


def make_missing_error(group: str, task: str) -> UserError:
    """Make the error that no installed package does a task, with the plug-ins that could not be loaded."""
    reasons = f" ({'; '.join(_failures[group])})" if group in _failures else ""
    return UserError(f"no installed package {task}{reasons}: install pendulum-ident again to register its own")
