"""What is measured is kept, whatever happens to the process."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.excitation import excitation
from pendulum_env.policy import OpenLoop, rollout
from pendulum_env.recording import read_recording
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RecordMeasurements
from tests.disks import full_after

POLICY = OpenLoop(excitation("paper", np.random.default_rng(0)), 1000.0)


def test_file_is_the_recording_of_the_rollout(tmp_path):
    with RecordMeasurements(gym.make(PENDULUM, torque_noise=0.1), tmp_path / "run.csv") as env:
        run = rollout(env, POLICY, 1500, seed=0)
    kept = read_recording(tmp_path / "run.csv")
    for name in ("time", "position", "torque"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(run, name))


def test_replay_of_what_was_recorded_records_the_same(tmp_path):
    first, second = (tmp_path / f"{name}.csv" for name in ("first", "second"))
    with RecordMeasurements(gym.make(PENDULUM), first) as env:
        rollout(env, POLICY, 1500, seed=0)
    with RecordMeasurements(gym.make(PENDULUM, backend="replay", recording=first), second) as env:
        rollout(env, POLICY, 5000)
    assert first.read_text().splitlines()[:-1] == second.read_text().splitlines()  # the last torque is not known


def test_each_episode_has_its_file_and_none_is_replaced(tmp_path):
    with RecordMeasurements(gym.make(PENDULUM), tmp_path / "run.csv") as env:
        env.reset()
        for _ in range(3):  # the first reset has no step and leaves no file
            rollout(env, POLICY, 1200)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-2.csv", "run-3.csv", "run.csv"]
    again = RecordMeasurements(gym.make(PENDULUM), tmp_path / "run.csv")
    with pytest.raises(FileExistsError, match="exists already: choose another name"):
        rollout(again, POLICY, 10)
    assert len(read_recording(tmp_path / "run.csv")) == 1200
    with RecordMeasurements(gym.make(PENDULUM), tmp_path / "run.csv", overwrite=True) as env:
        rollout(env, POLICY, 1100)
    assert len(read_recording(tmp_path / "run.csv")) == 1100


def test_an_episode_whose_file_failed_does_not_go_on_in_another(tmp_path):
    env = RecordMeasurements(gym.make(PENDULUM), tmp_path / "run.csv")
    env.reset()
    with full_after(50_000):
        with pytest.raises(OSError, match="were written: make room"):
            for _ in range(3000):
                env.step(np.array([1.0], dtype=np.float32))
        with pytest.raises(OSError, match="were written: make room"):
            env.step(np.array([1.0], dtype=np.float32))
    rollout(env, POLICY, 1200)  # there is room again
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-2.csv", "run.csv"]
    assert len(read_recording(tmp_path / "run-2.csv")) == 1200
    assert len(read_recording(tmp_path / "run.csv")) > 100  # half a row at its end is left out


def test_bad_paths_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"let the name end in \.csv"):
        RecordMeasurements(gym.make(PENDULUM), tmp_path / "run.npz")
    with pytest.raises(FileNotFoundError, match="create it first"):
        RecordMeasurements(gym.make(PENDULUM), tmp_path / "nowhere" / "run.csv")
