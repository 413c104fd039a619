"""Plants are drawn within their spread, by the seed, and only where there is a plant."""

import gymnasium as gym
import numpy as np
import pytest

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


@pytest.mark.parametrize(
    ("id", "spread", "why"),
    [
        ("Pendulum-v1", 0.2, "a recording or a rig is as it is"),
        (PENDULUM, {"mass": 0.1}, "no parameter 'mass'"),
        (PENDULUM, 1.0, "a share from 0 to below 1"),
    ],
)
def test_what_cannot_be_drawn_is_refused(id, spread, why):
    with pytest.raises(ValueError, match=why):
        RandomizePlant(gym.make(id), spread)
    with pytest.raises(ValueError, match="only the plants of batched pendulums can be drawn"):
        RandomizePlantVector(gym.make_vec("Pendulum-v1", num_envs=2))
