"""Read recordings of any mechanism in a log format."""

from dataclasses import replace
from functools import singledispatch

from pendulum_env.physics.mechanism import Mechanism
from pendulum_env.recording.formats import Readable
from pendulum_env.recording.record import Recording
from pendulum_env.recording.storage import read_recording
from pendulum_env.recording.study import Source


@singledispatch
def read_logged(mechanism: Mechanism, source: Readable, log_format: Source, name: str | None = None) -> Recording:
    """Read a recording of a mechanism in a log format, by the function that is registered for its type.

    Raises as `read_recording`.
    """
    options = {"has_gravity": log_format.has_gravity, **log_format.reading_options}
    return replace(read_recording(source, name=name, **options), load=log_format.load)
