"""What both tasks of choosing an excitation promise: Gymnasium's contract, episodes that end together, and seeds."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

from agents import ARM_DESIGN, DESIGN
from pendulum_env.plant import PAPER


def made(id, count, **arguments):
    return gym.make_vec(id, count, vectorization_mode="vector_entry_point", **arguments)


@pytest.mark.parametrize(
    ("id", "arguments"),
    [
        (DESIGN, {"constraint": "peak", "render_mode": "rgb_array"}),
        (DESIGN, {"constraint": "rms", "render_mode": "rgb_array"}),
        (ARM_DESIGN, {"seconds": 1.0}),
    ],
)
def test_the_checkers_have_nothing_to_say(id, arguments):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(id, **arguments).unwrapped, skip_render_check="render_mode" not in arguments)
        check_env_for_sb3(gym.make(id, **arguments))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(("id", "count", "seconds"), [(DESIGN, 1, 0.2), (ARM_DESIGN, 3, 1.0)])
def test_one_is_a_batch_of_one_whose_episode_ends_and_another_begins(id, count, seconds, mode):
    batch, one = made(id, count, seconds=seconds, autoreset_mode=mode), gym.make(id, seconds=seconds)
    (first, before), (alone, _) = batch.reset(seed=5), one.reset(seed=5)
    np.testing.assert_array_equal(first[-1], alone)
    for k in range(10):
        actions = np.random.default_rng(k).uniform(-1, 1, batch.action_space.shape).astype(np.float32)
        observations, rewards, terminated, truncated, info = batch.step(actions)
        alone, reward, _, ended, _ = one.step(actions[-1])
        assert rewards[-1] == pytest.approx(reward) and not terminated.any()
        assert (truncated == ended).all() and ended == (k == 9)
        last = info["final_obs"] if "final_obs" in info else observations
        np.testing.assert_allclose(last[-1], alone, atol=1e-6)
    if mode == "NextStep":
        observations, rewards, _, truncated, info = batch.step(actions)
        assert not rewards.any() and not truncated.any()
    if id == DESIGN:
        assert (last[0, 17], observations[0, 17]) == (0.0, 1.0)  # share of the time that is left
        assert all((info["plant"][name] != before["plant"][name]).all() for name in PAPER)
    else:
        np.testing.assert_allclose(observations, first)


@pytest.mark.parametrize(("id", "arguments"), [(DESIGN, {}), (ARM_DESIGN, {"draw": True})])
def test_the_seed_draws_plants_and_noise_or_limits_and_lengths(id, arguments):
    def seen(seed):
        env = made(id, 4, **arguments)
        some = np.full(env.action_space.shape, 0.5, dtype=np.float32)
        return np.array([env.reset(seed=seed)[0], *(env.step(some)[0] for _ in range(15))])

    first, again, other = (seen(seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first[-1] != other[-1]).any() and (first[-1, 0] != first[-1, 1]).any()


@pytest.mark.parametrize("id", [DESIGN, ARM_DESIGN])
def test_what_is_no_action_or_no_option_is_refused(id):
    env = made(id, 2)
    env.reset(seed=0)
    for action in (np.full(env.action_space.shape, np.nan), np.zeros(2)):
        with pytest.raises(ValueError, match=r"finite numbers of shape \(2, \d\)"):
            env.step(action)
    with pytest.raises(ValueError, match="unknown option of reset"):
        env.reset(options={"plants": 1})


def test_a_plant_may_be_given_in_part():
    plant = made(DESIGN, 3).reset(seed=0, options={"theta": {"gravity": [1.0, 2.0, 3.0]}})[1]["plant"]
    assert plant["gravity"].tolist() == [1.0, 2.0, 3.0] and len(set(plant["viscous"])) == 3
    with pytest.raises(TypeError, match="give parameters by name"):
        made(DESIGN, 3).reset(seed=0, options={"theta": np.ones((3, 4))})
    alone = gym.make(DESIGN).reset(seed=0, options={"theta": {"gravity": 1.5}})[1]["plant"]
    assert alone.keys() == set(PAPER) and alone["gravity"] == 1.5
