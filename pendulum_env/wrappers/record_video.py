"""Videos in the time of the simulation."""

from typing import Any

import gymnasium as gym
from gymnasium.wrappers import RecordVideo as RecordEveryStep


class RecordVideo(RecordEveryStep[Any, Any]):
    """Gymnasium's `RecordVideo` with `metadata["render_fps"]` frames per second of simulated time, at most 50.

    Gymnasium's wrapper keeps a picture of every step. At 1 kHz, a video of 20 s would have 20,000 frames.
    """

    def __init__(self, env: gym.Env[Any, Any], video_folder: str, **options: Any) -> None:
        """Wrap an environment of render mode "rgb_array"; `options` are those of Gymnasium's wrapper."""
        super().__init__(env, video_folder, **options)
        self._rate = float(getattr(env.unwrapped, "rate", self.frames_per_sec))  # steps per second [Hz]

    def start_recording(self, video_name: str) -> None:
        """Begin a video with the next frame."""
        super().start_recording(video_name)
        self._steps = 0

    def _capture_frame(self) -> None:
        """Keep the picture of a step if a frame is due."""
        frames = self._steps * self.frames_per_sec / self._rate
        self._steps += 1
        if frames + 1e-9 >= len(self.recorded_frames):
            super()._capture_frame()  # type: ignore[no-untyped-call]
