"""Effects are hidden as drawn: by the seed, within their ranges, and with the physics of the environment's own."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.physics.library import MEASURED, effects
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import HideEffects, HideEffectsVector, RandomizePlant, RandomizePlantVector

RANGES = {"stribeck": (0.2, 0.6), "cogging": {"order": (5, 7), "sin": 0.1}}


def test_presence_and_sizes_follow_the_seed_and_the_ranges():
    env = HideEffects(RandomizePlant(gym.make(PENDULUM)), RANGES, probability=0.3)
    plants = [env.reset(seed=7)[1]["plant"]] + [env.reset()[1]["plant"] for _ in range(300)]
    stribeck, cogging = (np.array([plant[name] for plant in plants]) for name in ("stribeck", "cogging.sin"))
    assert np.mean(stribeck > 0) == pytest.approx(0.3, abs=0.08) and np.mean(cogging > 0) == pytest.approx(
        0.3, abs=0.08
    )
    assert np.mean((stribeck > 0) & (cogging > 0)) == pytest.approx(0.09, abs=0.05)  # independent
    assert 0.2 < stribeck[stribeck > 0].min() < 0.25 and 0.55 < stribeck.max() < 0.6
    assert set(cogging) == {0.0, 0.1} and {plant["cogging.order"] for plant in plants} == {5, 6, 7}
    assert env.reset(seed=7)[1]["plant"] == plants[0]
    assert gym.make(env.spec).reset(seed=7)[1]["plant"] == plants[0]
    assert (
        HideEffects(RandomizePlant(gym.make(PENDULUM)), RANGES).reset(seed=7)[1]["plant"]["gravity"]
        == (RandomizePlant(HideEffects(gym.make(PENDULUM), RANGES)).reset(seed=7)[1]["plant"]["gravity"])
    )


@pytest.mark.parametrize("id", [id for id, kind in effects().items() if kind().columns and id not in MEASURED])
def test_every_effect_with_a_size_is_drawn(id):
    plant = HideEffects(gym.make(PENDULUM), [id], probability=1.0).reset(seed=1)[1]["plant"]
    assert any(plant[column.name] != 0.0 for column in effects()[id]().columns)


def move(env, steps=300):
    """Return the observations under a constant torque (T, ..., 3)."""
    env.reset(seed=0)
    torque = np.full(env.action_space.shape, 3.0, dtype=np.float32)
    return np.array([env.step(torque)[0] for _ in range(steps)])


@pytest.mark.parametrize("effect", ["quadratic_drag", "stribeck", "actuator_lag"])
def test_a_hidden_effect_acts_as_one_that_the_plant_was_made_with_and_an_absent_one_does_not(effect):
    sizes = {effect: {"quadratic_drag": 0.1, "stribeck": 0.5}.get(effect, 0.02)}
    made, bare = move(gym.make(PENDULUM, effects=sizes)), move(gym.make(PENDULUM))
    assert np.abs(made - bare).max() > 0.1
    for probability, expected in ((1.0, made), (0.0, bare)):
        single = HideEffects(gym.make(PENDULUM), sizes, probability=probability)
        batch = HideEffectsVector(gym.make_vec(PENDULUM, num_envs=2), sizes, probability=probability)
        for env in (single, batch):  # of engines that differ by some encoder counts
            motion = move(env)
            motions = motion if motion.ndim == 3 else motion[:, None]
            np.testing.assert_allclose(motions, np.broadcast_to(expected[:, None], motions.shape), atol=0.05)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_each_episode_of_a_batch_has_effects_of_its_own(mode):
    made = gym.make_vec(PENDULUM, num_envs=40, max_episode_steps=2, autoreset_mode=mode)
    env = HideEffectsVector(RandomizePlantVector(made), RANGES)
    first = env.reset(seed=3)[1]["plant"]
    action = np.zeros((40, 1), dtype=np.float32)
    infos = [env.step(action)[-1] for _ in range(3)]
    np.testing.assert_array_equal(infos[0]["plant"]["stribeck"], first["stribeck"])
    later = infos[-1]["plant"]
    assert (later["gravity"] != first["gravity"]).all() and np.mean(later["stribeck"] != first["stribeck"]) > 0.5
    assert 0.2 < np.mean(later["stribeck"] > 0) < 0.8
    np.testing.assert_array_equal(env.reset(seed=3)[1]["plant"]["stribeck"], first["stribeck"])


@pytest.mark.parametrize(
    ("effects", "why"),
    [
        ({"stribek": None}, "did you mean stribeck"),
        ({"stribeck": (0.6, 0.2)}, "lowest, highest"),
        ({"stribeck": "much"}, "lowest, highest"),
        ({"stribeck": (-0.2, 0.2)}, "cannot be -0.2"),
        ({"stribeck": {"speed": 0.2}}, "unknown parameter of stribeck 'speed'"),
        ("torque_saturation", "no size 0"),
    ],
)
def test_effects_that_cannot_be_drawn_are_refused(effects, why):
    with pytest.raises(ValueError, match=why):
        HideEffects(gym.make(PENDULUM), effects)


def test_wrappers_of_one_pendulum_name_those_of_batches():
    batch = gym.make_vec(PENDULUM, num_envs=2)
    for wrapper in (HideEffects, RandomizePlant):
        with pytest.raises(ValueError, match=f"wrap it in {wrapper.__name__}Vector"):
            wrapper(batch, {})
    with pytest.raises(ValueError, match="probability"):
        HideEffectsVector(batch, "stribeck", probability=2.0)
    with pytest.raises(ValueError, match="3 seeds do not fit 2 environments"):
        HideEffectsVector(batch, "stribeck").reset(seed=[1, 2, 3])
