"""Errors of the user, distinct from errors of the program."""

import traceback


class Mistake(ValueError):
    """Input that cannot be used; the message is one sentence: what is wrong, where, and what to do about it."""


def one_line(error: BaseException | str) -> str:
    """The text of a library's error, fit for the middle of a sentence."""
    return " ".join(str(error).split())[:200].rstrip(".:") or type(error).__name__


def told(error: BaseException) -> str:
    """Kind and message of any exception, even of one that cannot say it; of a mistake, its sentence."""
    if isinstance(error, Mistake):
        return str(error)
    return "".join(traceback.format_exception_only(error)).strip()
