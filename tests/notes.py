"""Notes on recordings as a reader sees them."""

from pendulum_env.recording import Recording
from workbench.narrator.notes import describe_note


def list_notes(recording: Recording) -> tuple[str, ...]:
    """What was changed in a recording or guessed of it, in words."""
    return tuple(map(describe_note, recording.notes))
