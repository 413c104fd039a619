"""Replay backend: returns the samples of a recording and ignores the torque."""

from pendulum_env.backends.port import Backend, Sample, Setup, Start, Status, Traits
from pendulum_env.recording import Recording, read_recording


class Replay(Backend):
    """Backend that replays torque, position and, if recorded, velocity."""

    def __init__(self, setup: Setup) -> None:
        """Read the recording of the setup.

        Raises:
            ValueError: if the setup has no recording.
            RecordingError: if the recording cannot be read.
        """
        if setup.recording is None:
            raise ValueError("backend 'replay' needs a recording: pass recording='run.csv'")
        self.recording: Recording = read_recording(setup.recording)
        self.traits = Traits(self.recording.rate, counts=None, recording=self.recording)

    def enable(self, start: Start) -> Sample:
        self._index = 0
        return self._sample()

    def exchange(self, torque: float) -> Sample:
        self._index = min(self._index + 1, len(self.recording) - 1)
        return self._sample()

    def _sample(self) -> Sample:
        run, k = self.recording, self._index
        return Sample(
            float(run.time[k] - run.time[0]),
            float(run.position[k]),
            None if run.velocity is None else float(run.velocity[k]),
            float(run.torque[k - 1]) if k else 0.0,  # recorded torque acts from its sample on
            Status.RUNNING if k < len(run) - 1 else Status.ENDED,
        )
