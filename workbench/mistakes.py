"""Mistakes of a user, which end a command with one line, not of the program."""

from __future__ import annotations

import re

from pendulum_env.mistake import Mistake


class InputError(Mistake):
    """A command was asked for something that cannot be; the message is one sentence that says what and why."""


class Interrupted(KeyboardInterrupt):
    """A command was interrupted; the message says what is left of its work."""


MISTAKES = (Mistake, OSError, ModuleNotFoundError)  # the last of an extra, whose name it tells
LONGEST = 500  # characters of a sentence
PART = r"\S{0,40}"  # of a word that a cut would go through


def sentence(mistake: Exception) -> str:
    """A user's mistake in one line of at most `LONGEST` characters, none of which a terminal would obey.

    Of a longer one whole words in the middle are left out.
    """
    if isinstance(mistake, OSError) and mistake.strerror is not None:
        where = f"{mistake.filename}: " if mistake.filename is not None else ""
        text = f"{where}{mistake.strerror}"
    else:
        text = str(mistake)
    text = printable(" ".join(text.split()))
    if len(text) <= LONGEST:
        return text
    first, last = text[: LONGEST // 2 - 3], text[-(LONGEST // 2 - 2) :]
    return f"{re.sub(f' {PART}$', '', first)} ... {re.sub(f'^{PART} ', '', last)}"


def printable(text: str) -> str:
    """Text in which every character can be printed and stored: what a name of a file may hold beyond is escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
