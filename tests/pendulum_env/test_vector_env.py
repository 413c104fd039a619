"""Batched pendulums: the same physics as one, and Gymnasium's rules for starting anew."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pendulum_env.excitation import excitation
from pendulum_env.policy import OpenLoop
from pendulum_env.registration import PENDULUM


def torques(steps: int, count: int) -> np.ndarray:
    time = np.arange(steps) / 1000
    phases = np.arange(count)
    return (3 * np.sin(12.07 * time[:, None] + phases) + 3 * np.sin(2.25 * time[:, None])).astype(np.float32)


def test_next_step_starts_an_ended_pendulum_anew_and_same_step_keeps_its_last_observation():
    action = np.full((2, 1), 5.0, dtype=np.float32)
    env = gym.make_vec(PENDULUM, num_envs=2, max_episode_steps=3)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    env.reset(seed=0)
    runs = [env.step(action) for _ in range(5)]
    assert runs[2][3].all() and (runs[2][-1]["position"] != 0).all()
    *_, truncated, info = runs[3]
    assert not truncated.any() and not any(info[name].any() for name in ("position", "time", "torque"))
    assert (runs[4][-1]["time"] == 0.001).all()
    env = gym.make_vec(PENDULUM, num_envs=2, max_episode_steps=3, autoreset_mode="SameStep")
    env.reset(seed=0)
    observation, _, _, truncated, info = [env.step(action) for _ in range(3)][-1]
    assert truncated.all()
    np.testing.assert_array_equal(observation, [[1, 0, 0]] * 2)
    assert (info["final_obs"][:, 2] > 0).all()
    assert (info["final_info"]["time"] == 0.003).all() and (info["time"] == 0).all()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_clipped_is_said_of_each_pendulum_and_not_of_one_that_starts_anew(mode):
    env = gym.make_vec(PENDULUM, num_envs=2, max_torque=3.0, max_episode_steps=3, autoreset_mode=mode)
    assert env.reset(seed=0)[1]["clipped"].tolist() == [False, False]
    infos = [env.step(np.array([[4.0], [3.0]], dtype=np.float32))[-1] for _ in range(4)]
    ended = infos[2]["final_info"] if mode == "SameStep" else infos[2]
    assert ended["clipped"].tolist() == infos[0]["clipped"].tolist() == [True, False]
    anew = infos[2] if mode == "SameStep" else infos[3]
    assert anew["time"].tolist() == [0, 0] and anew["clipped"].tolist() == [False, False]


@pytest.mark.parametrize("effect", ["actuator_lag", "dead_time", "presliding", "joint_flexibility"])
def test_a_new_episode_knows_nothing_of_the_last(effect):
    env = gym.make_vec(PENDULUM, num_envs=2, max_episode_steps=200, effects=[effect])
    action = torques(400, 2)

    def episode():
        return np.array([env.step(row[:, None])[-1]["position"] for row in action[:200]])

    env.reset(seed=0)
    first = episode()
    env.step(action[0][:, None])  # starts both anew
    np.testing.assert_array_equal(first, episode())


def test_seeded_and_open_loop():
    signal = OpenLoop(excitation("paper", np.random.default_rng(0)), 1000.0)

    def run():
        env = gym.make_vec(PENDULUM, num_envs=3, torque_noise=0.1)
        observation, _ = env.reset(seed=5)
        state = None
        for _ in range(50):
            action, state = signal.predict(observation, state)
            observation, *_, info = env.step(action)
        return info["torque"]

    np.testing.assert_array_equal(run(), run())
    assert len(set(run())) == 3


def test_bad_arguments_are_refused():
    env = gym.make_vec(PENDULUM, num_envs=2)
    env.reset()
    for asked, why in (
        (lambda: gym.make_vec(PENDULUM, num_envs=0), "num_envs of pendulums cannot be 0"),
        (lambda: gym.make_vec(PENDULUM, num_envs=1, autoreset_mode="Disabled"), "restart by themselves"),
        (lambda: gym.make_vec(PENDULUM, num_envs=1, max_torque=-1), "max_torque of pendulums cannot be -1"),
        (lambda: env.step(np.zeros((1, 1))), r"the actions have shape \(1, 1\), 2 pendulums need one each"),
        (lambda: env.step(np.array([[0.0], [np.nan]])), "pendulum 1 is NaN"),
        (lambda: env.reset(options={"theta": np.ones(4)}), "give parameters by name"),
    ):
        with pytest.raises((TypeError, ValueError), match=why):
            asked()
