"""Errors of the user, distinct from errors of the program."""

import traceback


class UserError(ValueError):
    """Invalid input; the message is one sentence with the fault, its place and the remedy."""


class FileError(UserError):
    """File that cannot be read, or that holds an invalid value."""


class RecordingError(UserError):
    """Recording that cannot be used."""


class MotionlessError(RecordingError):
    """Recording of a joint at rest; other recordings of the joint can be used without it."""


class ColumnError(RecordingError):
    """Columns with an unknown meaning, or one that contradicts the data; the user must give it."""


def shorten_error(error: BaseException | str) -> str:
    """Return the text of an error on one line of up to 200 characters, without the final full stop."""
    return " ".join(str(error).split())[:200].rstrip(".:") or type(error).__name__


def format_error(error: BaseException) -> str:
    """Return class and message of an exception, also if its `str` fails; of a `UserError`, only the message."""
    if isinstance(error, UserError):
        return str(error)
    return "".join(traceback.format_exception_only(error)).strip()
