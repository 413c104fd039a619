"""A policy at work on a pendulum: it does there what it does where it was trained, and keeps to its constraint."""

import gymnasium as gym
import numpy as np
import pytest

from agents import Pilot, load
from agents.design_env import ExcitationDesignVector
from agents.observer import CONSTRAINTS
from estimators import identify
from pendulum_env.plant import PAPER
from pendulum_env.policy import rollout
from pendulum_env.recording import read_recording
from pendulum_env.registration import PENDULUM
from workbench.cli import main


@pytest.mark.parametrize("constraint", CONSTRAINTS)
def test_it_acts_as_in_the_environment_of_its_training(constraint):
    """The same measurement, sample by sample, gives the same torques."""
    env, policy = ExcitationDesignVector(1, constraint=constraint), load(constraint)
    pilot = Pilot(policy, constraint)
    observation, info = env.reset(seed=0)
    wanted = pilot.torque({"time": 0.0, "position": info["positions"][0, 0], "velocity": 0.0, "torque": 0.0})
    for k in range(100):
        observation, *_, info = env.step(policy.predict(observation)[0])
        assert wanted == pytest.approx(info["torque"][0], rel=1e-6)
        for j, (position, torque) in enumerate(zip(info["positions"][0], info["torques"][0], strict=True)):
            sample = {"time": (20 * k + j + 1) / 1000, "position": position, "velocity": 0.0, "torque": torque}
            held, wanted = wanted, pilot.torque(sample)
            assert j == 19 or wanted == held


def test_runs_repeat_and_begin_anew():
    pilot = Pilot(load("rms"), "rms", seconds=1.0, rate=500.0)
    first, again = (rollout(gym.make(PENDULUM, rate=500.0, torque_noise=0.02), pilot, 500, seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.torque, again.torque)
    assert np.sqrt(np.mean(first.torque**2)) < 3.1


def test_a_rate_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="730 Hz: give a multiple of 50 Hz"):
        Pilot(load("peak"), rate=730.0)
    with pytest.raises(ValueError, match="laid out for 500 Hz"):
        rollout(gym.make(PENDULUM), Pilot(load("peak"), rate=500.0), 10)


def test_record_by_a_policy(tmp_path, capsys):
    path, policy = tmp_path / "run.csv", tmp_path / "own.npz"
    load("peak").save(policy)
    assert main(["record", "--excitation", "rl", "--seconds", "4", "-o", str(path)]) == 0
    own = tmp_path / "own.csv"
    assert main(["record", "--excitation", "rl", "--policy", str(policy), "--seconds", "4", "-o", str(own)]) == 0
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.torque, read_recording(own).torque)
    assert np.abs(recording.torque).max() < 6.2
    found = identify([recording])["filtered_dynamic"].model.theta
    np.testing.assert_allclose(found, list(PAPER.values()), rtol=0.01)
