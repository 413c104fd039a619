"""Recordings and studies, read from files and written to files."""

from pendulum_env.errors import RecordingError
from pendulum_env.recording.channel import NEWTON_METRE, PER_INERTIA, Load, TorqueConstant
from pendulum_env.recording.notes import Note, NoteKind, RecordingWarning
from pendulum_env.recording.record import MovedTorque, Recording
from pendulum_env.recording.storage import read_recording, write_recording
from pendulum_env.recording.study import Source, Study, StudyError, read_study, write_study

__all__ = [
    "NEWTON_METRE",
    "PER_INERTIA",
    "Load",
    "MovedTorque",
    "Note",
    "NoteKind",
    "Recording",
    "RecordingError",
    "RecordingWarning",
    "Source",
    "Study",
    "StudyError",
    "TorqueConstant",
    "read_recording",
    "read_study",
    "write_recording",
    "write_study",
]
