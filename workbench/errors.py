"""Errors caused by the user's input, and their one-line messages."""

import re
import shlex
from collections.abc import Mapping

from pendulum_env.errors import UserError


class InputError(UserError):
    """Invalid input of a command; the message is one sentence with the cause and the remedy."""


class Interrupted(KeyboardInterrupt):
    """Interrupt of a command; the message names the files that were kept."""


OPTIONS = {"fixed": "--fix", "bounds": "--bound"}  # options by the Python name of the argument, where they differ
USER_ERRORS = (UserError, OSError, ModuleNotFoundError)  # ModuleNotFoundError: an extra is not installed
LONGEST = 700  # largest length of a message [characters]


def write_option(name: str, value: object) -> str:
    """Format an argument of a library function as a command-line option, quoted for a shell."""
    option = OPTIONS.get(name, f"--{name.replace('_', '-')}")
    if value is True:
        return option
    if isinstance(value, Mapping):
        value = ",".join(f"{key}={item}" for key, item in value.items())
    return f"{option} {shlex.quote(str(value))}"


def format_mistake(error: Exception) -> str:
    """Format an error as one printable line; a text of more than `LONGEST` characters loses its middle."""
    if isinstance(error, OSError) and error.strerror is not None:
        text = f"{error.filename}: {error.strerror}" if error.filename is not None else error.strerror
    else:
        text = str(error)
    text = escape_controls(" ".join(text.split()))
    if len(text) <= LONGEST:
        return text
    half = LONGEST // 2 - 3
    first, last = re.sub(r"\S{0,40}$", "", text[:half]), re.sub(r"^\S{0,40}", "", text[-half:])
    return f"{first.rstrip()} ... {last.lstrip()}"


def escape_controls(text: str) -> str:
    """Replace unprintable characters of a text by escape sequences."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
