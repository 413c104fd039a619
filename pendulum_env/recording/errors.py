"""Errors of recordings and of their files."""

from pendulum_env.mistake import Mistake


class RecordingError(Mistake):
    """A recording cannot be used; the message is one sentence with where, why and what to do about it."""


class ColumnError(RecordingError):
    """What the columns of a file mean is not known, or cannot be what was said or guessed: saying it mends it."""
