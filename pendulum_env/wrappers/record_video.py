"""Videos in true time."""

import math
from typing import Any

import gymnasium as gym
from gymnasium.wrappers import RecordVideo as EveryStep

from pendulum_env.rendering import FRAMES


class RecordVideo(EveryStep[Any, Any]):
    """Gymnasium's `RecordVideo` with 50 frames per second of simulated time, whatever the rate of the environment.

    Gymnasium's own keeps a picture of every step: at 1 kHz a video of 1,000 frames per second, and 0.9 GB of memory
    for a second. Here pictures are left out, or shown for several frames where a step is longer than a frame;
    `metadata["render_fps"]` tells how many steps a second has. Needs moviepy, which is the extra `video`.
    """

    def __init__(self, env: gym.Env[Any, Any], video_folder: str, *, fps: int = FRAMES, **options: Any) -> None:
        """Wrap an environment of render mode "rgb_array".

        Args:
            env: the environment.
            video_folder: where videos go.
            fps: frames per second of simulated time.
            options: of Gymnasium's wrapper, as `episode_trigger` and `name_prefix`; `video_length` counts frames.
        """
        super().__init__(env, video_folder, fps=fps, **options)
        self._rate = float(env.metadata["render_fps"])  # [Hz]

    def start_recording(self, video_name: str) -> None:
        """Begin a video, now."""
        super().start_recording(video_name)
        self._steps = 0

    def _capture_frame(self) -> None:
        # frame n shows the first state from n / fps on
        due = math.floor(self._steps * self.frames_per_sec / self._rate + 1e-9) + 1
        self._steps += 1
        for _ in range(due - len(self.recorded_frames)):
            if self.recording:  # until something is drawn that is no picture
                super()._capture_frame()  # type: ignore[no-untyped-call]
