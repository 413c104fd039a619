"""A second of a video is a second of the simulation, whatever the rate."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.registration import ARM, DESIGN, PENDULUM
from pendulum_env.rendering import FRAMES
from pendulum_env.wrappers import RecordVideo


def filmed(env: RecordVideo, steps: int) -> list[np.ndarray]:
    """Pictures of the states, one more than steps, under a torque that turns the arm."""
    env.reset(seed=0)
    pictures = [env.render()]
    for _ in range(steps):
        env.step(np.full(env.action_space.shape, 0.9, dtype=np.float32) * env.action_space.high)
        pictures.append(env.render())
    return pictures


@pytest.mark.parametrize(
    ("id", "settings", "seconds"),
    [
        (PENDULUM, {"rate": 120.0}, 0.5),
        (PENDULUM, {"rate": 12.5}, 0.8),
        (ARM, {"rate": 1000.0}, 0.1),
        (DESIGN, {}, 0.2),
    ],
)
def test_a_video_lasts_as_long_as_what_it_shows(id, settings, seconds, tmp_path):
    moviepy = pytest.importorskip("moviepy")
    env = RecordVideo(gym.make(id, render_mode="rgb_array", **settings), str(tmp_path / "videos"))
    rate = env.metadata["render_fps"]
    filmed(env, round(seconds * rate))
    env.close()
    with moviepy.VideoFileClip(str(tmp_path / "videos" / "rl-video-episode-0.mp4")) as video:
        assert video.fps == FRAMES
        assert seconds - 1 / rate < video.duration <= seconds + 1.01 / FRAMES


@pytest.mark.parametrize("rate", [500.0, 120.0, 20.0])
def test_a_frame_shows_the_first_state_from_its_time_on(rate, tmp_path):
    pytest.importorskip("moviepy")
    env = RecordVideo(gym.make(PENDULUM, rate=rate, render_mode="rgb_array"), str(tmp_path / "videos"))
    pictures = filmed(env, round(0.2 * rate))
    frames, env.recorded_frames = env.recorded_frames, []
    assert len(frames) == 0.2 * FRAMES + 1
    for n, frame in enumerate(frames):
        np.testing.assert_array_equal(frame, pictures[int(np.ceil(n / FRAMES * rate - 1e-9))])


def test_spec_rebuilds_it(tmp_path):
    pytest.importorskip("moviepy")
    env = RecordVideo(gym.make(PENDULUM, render_mode="rgb_array"), str(tmp_path / "videos"), fps=25, name_prefix="arm")
    (tmp_path / "videos").rmdir()
    again = gym.make(env.spec)
    assert isinstance(again, RecordVideo)
    assert (again.frames_per_sec, again.name_prefix) == (25, "arm")
