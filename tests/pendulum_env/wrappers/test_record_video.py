"""Videos in the time of the simulation."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.wrappers import RecordVideo

PENDULUM = "pendulum_env/DirectDrivePendulum-v0"


@pytest.mark.parametrize(("rate", "frames"), [(1000.0, 10), (130.0, 10), (20.0, 4)])
def test_a_video_has_fifty_frames_a_second_or_one_of_each_slower_step(tmp_path, rate, frames):
    pytest.importorskip("moviepy")
    env = RecordVideo(
        gym.make(PENDULUM, rate=rate, render_mode="rgb_array"), str(tmp_path / "videos"), disable_logger=True
    )
    assert env.metadata["render_fps"] == env.frames_per_sec == min(rate, 50)
    env.reset(seed=1)
    for _ in range(int(0.199 * rate)):  # 0.2 s with the start
        env.step(np.array([2.0], dtype=np.float32))
    assert len(env.recorded_frames) == frames
    assert (env.recorded_frames[0] != env.recorded_frames[-1]).any()
    env.close()
    assert list(tmp_path.glob("videos/*.mp4"))
