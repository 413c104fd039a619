"""Libraries of the formats, which only an export needs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from workbench.mistakes import InputError


def needed(module: str) -> Any:
    """A module of the extra `export`.

    Raises:
        InputError: if it is not installed; the message names the command that does it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is not None and error.name.partition(".")[0] != module.partition(".")[0]:
            raise
        raise InputError(
            f"this needs {module.partition('.')[0]}: install it with pip install 'pendulum-ident[export]'"
        ) from None
