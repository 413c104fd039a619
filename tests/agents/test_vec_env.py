"""Batched pendulums learn with stable-baselines3."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RescaleAction
from gymnasium.wrappers.vector import RescaleAction as RescaleActions
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from agents.vec_env import BatchedVecEnv
from estimators.wrappers import EstimateParameters, EstimateParametersVector, InformationReward, InformationRewardVector
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RandomizePlantVector


def test_stable_baselines_checker_has_nothing_to_say():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(RescaleAction(gym.make(PENDULUM), np.float32(-1), np.float32(1)))
        check_env(InformationReward(EstimateParameters(gym.make(PENDULUM, max_torque=1.0), in_observation=True)))


def made(count, steps, **arguments):
    env = gym.make_vec(PENDULUM, num_envs=count, max_episode_steps=steps, autoreset_mode="SameStep", **arguments)
    env = InformationRewardVector(EstimateParametersVector(env, schemes="dynamic", in_observation=True))
    return BatchedVecEnv(env)


def test_episodes_end_as_vec_envs_do():
    env = made(3, 500)
    env.seed(4)
    observation = env.reset()
    assert env.observation_space.contains(observation[0])
    for k in range(500):
        last = observation
        observation, reward, done, infos = env.step(np.full((3, 1), 5.0 * np.sin(0.02 * k), dtype=np.float32))
        assert done.all() == (k == 499)
    assert infos[0]["TimeLimit.truncated"]
    assert infos[0]["terminal_observation"].shape == last[0].shape
    np.testing.assert_array_equal(observation[:, :7], [[1, 0, 0, 0, 0, 0, 0]] * 3)  # nothing is estimated yet
    np.testing.assert_allclose(infos[0]["terminal_observation"][3:7], last[0][3:7], rtol=0.05)  # and here it was
    assert infos[0]["terminal_observation"][3] > 0.05
    assert reward.dtype == np.float32


def test_ppo_learns_on_batched_pendulums_and_repeats_itself():
    def weights():
        env = VecNormalize(VecMonitor(made(8, 64, rate=200.0)))
        model = PPO("MlpPolicy", env, n_steps=64, batch_size=256, n_epochs=1, seed=1, device="cpu")
        model.learn(1024)
        assert model.ep_info_buffer
        return np.concatenate([p.detach().numpy().ravel() for p in model.policy.parameters()])

    np.testing.assert_array_equal(weights(), weights())


def test_pendulums_that_start_anew_later_are_refused():
    with pytest.raises(ValueError, match="autoreset_mode='SameStep'"):
        BatchedVecEnv(gym.make_vec(PENDULUM, num_envs=2))


def test_actions_may_be_rescaled():
    env, plain = (gym.make_vec(PENDULUM, num_envs=2, autoreset_mode="SameStep") for _ in range(2))
    scaled, plain = BatchedVecEnv(RescaleActions(env, np.float32(-1), np.float32(1))), BatchedVecEnv(plain)
    paths = []
    for own, action in ((scaled, 1.0), (plain, 15.0)):
        own.seed(0)
        own.reset()
        paths.append([own.step(np.full((2, 1), action, dtype=np.float32))[0] for _ in range(20)])
    np.testing.assert_allclose(*paths, rtol=1e-5)


def test_entries_of_info_that_are_asked_for_belong_to_the_episode_of_their_step():
    env = gym.make_vec(PENDULUM, num_envs=2, max_episode_steps=2, autoreset_mode="SameStep")
    env = BatchedVecEnv(RandomizePlantVector(env), info=["plant", "time"])
    env.seed(1)
    env.reset()
    first = [info["plant"]["gravity"] for info in env.reset_infos]
    steps = [env.step(np.zeros((2, 1), dtype=np.float32))[-1] for _ in range(3)]
    assert [info["time"] for info in (steps[k][1] for k in range(3))] == pytest.approx([0.001, 0.002, 0.001])
    gravities = [[info["plant"]["gravity"] for info in infos] for infos in steps]
    assert gravities[0] == gravities[1] == first and not set(gravities[2]) & set(first)
    assert set(steps[0][0]) == {"plant", "time"}
    with pytest.raises(ValueError, match="entry of info"):
        BatchedVecEnv(env.env, info="plants").reset()
