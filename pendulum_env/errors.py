"""Errors of the user, distinct from errors of the program."""

import traceback


class UserError(ValueError):
    """Input that cannot be used; the message is one sentence with the fault, its place and the remedy."""


class FileError(UserError):
    """A file that cannot be read, or a value in it that is invalid."""


class RecordingError(UserError):
    """A recording that cannot be used."""


class ColumnError(RecordingError):
    """Columns with an unknown meaning, or with one that contradicts the data: the user has to give it."""


def shorten_error(error: BaseException | str) -> str:
    """Return the text of a library's error for the middle of a sentence."""
    return " ".join(str(error).split())[:200].rstrip(".:") or type(error).__name__


def format_error(error: BaseException) -> str:
    """Return kind and message of any exception, even of one whose `str` fails; of a `UserError`, its sentence."""
    if isinstance(error, UserError):
        return str(error)
    return "".join(traceback.format_exception_only(error)).strip()
