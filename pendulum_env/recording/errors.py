"""Errors of recordings and of their files."""

from pendulum_env.mistake import Mistake


class RecordingError(Mistake):
    """A recording cannot be used; the message is one sentence with where, why and what to do about it."""


class ColumnError(RecordingError):
    """The meaning of columns is unknown, or contradicts the data: the user has to give it."""
