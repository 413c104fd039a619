"""Recordings of a pendulum: one record type, read from and written to CSV, Parquet and NPZ."""

from pendulum_env.recording.record import Recording, RecordingError
from pendulum_env.recording.storage import read_recording, write_recording

__all__ = ["Recording", "RecordingError", "read_recording", "write_recording"]
