"""Mistakes of a user, which end a command with one line, not of the program."""

import re
import shlex
from collections.abc import Mapping

from pendulum_env.errors import UserError


class InputError(UserError):
    """A command was asked for something that cannot be; the message is one sentence that says what and why."""


class Interrupted(KeyboardInterrupt):
    """A command was interrupted; the message says what is left of its work."""


OPTIONS = {"fixed": "--fix", "bounds": "--bound"}  # of arguments that have another name in Python
USER_ERRORS = (UserError, OSError, ModuleNotFoundError)  # the last of an extra, whose name it tells
LONGEST = 500  # characters of a sentence


def write_option(name: str, value: object) -> str:
    """Write an argument of the libraries as the option of a command, ready to paste."""
    option = OPTIONS.get(name, f"--{name.replace('_', '-')}")
    if value is True:
        return option
    if isinstance(value, Mapping):
        value = ",".join(f"{key}={item}" for key, item in value.items())
    return f"{option} {shlex.quote(str(value))}"


def format_mistake(mistake: Exception) -> str:
    """Format a user's mistake as one printable line of at most `LONGEST` characters.

    Of a longer one some words in the middle are left out.
    """
    if isinstance(mistake, OSError) and mistake.strerror is not None:
        text = f"{mistake.filename}: {mistake.strerror}" if mistake.filename is not None else mistake.strerror
    else:
        text = str(mistake)
    text = escape_controls(" ".join(text.split()))
    if len(text) <= LONGEST:
        return text
    half = LONGEST // 2 - 3
    first, last = re.sub(r"\S{0,40}$", "", text[:half]), re.sub(r"^\S{0,40}", "", text[-half:])
    return f"{first.rstrip()} ... {last.lstrip()}"


def escape_controls(text: str) -> str:
    """Escape the characters of a text that cannot be printed."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
