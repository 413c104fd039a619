"""Plants are drawn within their spread, by the seed, and only where there is a plant."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.physics import BASE, Model
from pendulum_env.physics.friction import Stribeck
from pendulum_env.plant import PAPER
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RandomizePlant, RandomizePlantVector


def test_plants_stay_within_their_spread_and_follow_the_seed():
    env = RandomizePlant(gym.make(PENDULUM), 0.3)
    plants = [env.reset(seed=7)[1]["plant"]] + [env.reset()[1]["plant"] for _ in range(200)]
    ratios = np.array([[plant[name] / usual for name, usual in PAPER.items()] for plant in plants])
    assert ratios.min() > 0.7 and ratios.max() < 1.3
    assert ratios.std(axis=0) == pytest.approx(0.3 / np.sqrt(3), rel=0.15)
    assert env.reset(seed=7)[1]["plant"] == plants[0]


def test_the_drawn_plant_is_the_one_that_moves():
    env = RandomizePlant(gym.make(PENDULUM, counts=0), {"gravity": 0.5})
    _, info = env.reset(seed=1)
    drawn = gym.make(PENDULUM, counts=0, theta=info["plant"])
    drawn.reset(seed=1)
    for _ in range(500):
        action = np.array([4.0], dtype=np.float32)
        assert env.step(action)[-1]["position"] == drawn.step(action)[-1]["position"]
    assert info["plant"]["inertia"] == PAPER["inertia"]


def test_batched_pendulums_get_new_plants_with_each_episode():
    env = RandomizePlantVector(gym.make_vec(PENDULUM, num_envs=3, max_episode_steps=2), 0.2)
    first = env.reset(seed=3)[1]["plant"]["gravity"]
    assert len(set(first)) == 3
    action = np.zeros((3, 1), dtype=np.float32)
    assert (env.step(action)[-1]["plant"]["gravity"] == first).all()
    env.step(action)
    assert (env.step(action)[-1]["plant"]["gravity"] != first).all()
    assert (env.reset(seed=3)[1]["plant"]["gravity"] == first).all()
    assert (env.reset(options={"theta": {"gravity": 1.0}})[1]["plant"]["gravity"] == 1.0).all()


def test_plants_are_drawn_as_an_identified_model_knows_its_linear_parameters():
    std = np.array([0.004, 0.1, 0.02, 0.05])
    covariance = np.diag(std**2)
    covariance[2, 3] = covariance[3, 2] = -0.9 * std[2] * std[3]
    model = Model.build((*BASE, Stribeck()), [0.09, 2.0, 0.35, 0.9, 0.001], [*std, 0.0005])
    model = model.with_covariance(list(PAPER), covariance)
    env = RandomizePlantVector(gym.make_vec(PENDULUM, num_envs=20_000, model=model), "covariance")
    plant = env.reset(seed=5)[1]["plant"]
    drawn = np.stack([plant[column.name] for column in model.columns], axis=1)
    base = (drawn[:, :4] - model.theta[:4]) / std
    np.testing.assert_allclose(base.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(np.cov(base.T), covariance / np.outer(std, std), atol=0.05)
    assert (drawn[:, 4] == 0).any() and (drawn[:, 4] >= 0).all()  # friction does not drive


@pytest.mark.parametrize(
    ("id", "spread", "why"),
    [
        ("Pendulum-v1", 0.2, "a recording or a rig is as it is"),
        (PENDULUM, {"mass": 0.1}, "no parameter 'mass'"),
        (PENDULUM, 1.0, "a share from 0 to below 1"),
        (PENDULUM, "covariances", "by 'covariances': give shares"),
        (PENDULUM, "covariance", "which has no covariance: take a fitted model"),
    ],
)
def test_what_cannot_be_drawn_is_refused(id, spread, why):
    with pytest.raises(ValueError, match=why):
        RandomizePlant(gym.make(id), spread)
    with pytest.raises(ValueError, match="only the plants of batched pendulums can be drawn"):
        RandomizePlantVector(gym.make_vec("Pendulum-v1", num_envs=2))
