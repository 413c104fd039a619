"""Telling structures apart: the expected gain is that of real fits, and the task pays for it."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from agents import DESIGN, Pilot, load
from agents.baselines import SEPARATING
from agents.design_env import ExcitationDesignVector
from agents.knowledge import COUNT
from agents.network import NAMES
from agents.observer import CONSTRAINTS, INPUTS
from agents.structure import DISCRIMINATE, NOISE, PROBES, STRUCTURE_FEATURES, Structure, drawn, promised, worth
from agents.verdicts import judge
from pendulum_env.physics import Samples


def seen(ticks: int = 300) -> tuple[Structure, np.ndarray]:
    """A structure that has seen some motion of one plant, and the rows of all columns (T, P)."""
    rng, structure, rows = np.random.default_rng(0), Structure(), []
    structure.start(1)
    for _ in range(ticks):
        base = rng.normal(size=(1, COUNT))
        q, v, tau = rng.uniform(-3, 3, (3, 1, 1)) * [[[1.0]], [[2.0]], [[2.0]]]
        v = np.abs(v) if len(rows) < ticks // 2 else -np.abs(v)  # one reversal, about which two ticks do not count
        x = Samples(np.zeros((1, 1)), q, v, tau)
        structure.take(base, x, np.zeros(1), np.ones(1, dtype=bool))
        rows.append(np.concatenate([base[0], structure.rows(x)[0]]))
    counted = set(range(1, ticks - 1)) - {ticks // 2 - 1, ticks // 2}
    return structure, np.array(rows)[sorted(counted)]


@pytest.mark.parametrize("true", range(len(PROBES)))
def test_the_expected_gain_is_what_the_best_rival_leaves_unexplained(true):
    structure, rows = seen()
    _, size = drawn(np.random.default_rng(true), PROBES, 1)
    size = np.where(structure.owner == true, 0.3, 0.0)[None]
    torque = rows[:, COUNT:] @ size[0]
    left = []
    for rival in set(range(len(PROBES))) - {true}:
        columns = [*range(COUNT), *(COUNT + np.flatnonzero(structure.owner == rival))]
        fit = np.linalg.lstsq(rows[:, columns], torque, rcond=None)[0]
        left.append(np.sum((torque - rows[:, columns] @ fit) ** 2))
    gain = structure.gained(np.array([true]), size)[0]
    assert gain == pytest.approx(min(left) / (2 * NOISE**2), rel=1e-4)


def test_more_is_promised_the_more_is_seen():
    few, many = seen(20)[0], seen(300)[0]
    assert promised(few.information)[0] < promised(many.information)[0] <= worth(np.array(np.inf))


def test_each_plant_hides_one_effect_and_friction_never_drives():
    hidden, size = drawn(np.random.default_rng(0), PROBES, 500)
    owner = Structure().owner
    assert all(set(owner[row != 0]) == {k} for k, row in zip(hidden, size, strict=True))
    one_way = [k for k, term in enumerate(PROBES) if term.id in ("stribeck", "load_dependent_friction")]
    assert (size[:, np.isin(owner, one_way)] >= 0).all() and (size < 0).any()
    assert set(hidden) == set(range(len(PROBES)))


@pytest.mark.parametrize("constraint", CONSTRAINTS)
def test_an_episode_pays_what_was_gained_in_all(constraint):
    env = ExcitationDesignVector(3, constraint=constraint, criterion=DISCRIMINATE, seconds=1.0)
    observation, _ = env.reset(seed=0)
    total, spent = np.zeros(3), np.zeros(3)
    for k in range(50):
        action = np.full((3, 1), np.sin(0.25 * k))
        observation, reward, *_, info = env.step(action)
        total += reward
        spent += info["torque"] ** 2
        if env.constraint.rms is not None:
            assert (spent <= env.constraint.rms**2 * (k + 1 + 50) + 1e-6).all()  # a second ahead at most
    assert observation.shape == (3, INPUTS + STRUCTURE_FEATURES)
    assert env.observer.structure is not None and (total >= 0).all()
    gain = env.observer.structure.gained(*env._true)
    np.testing.assert_allclose(total, worth(gain), atol=0.2)  # the prior knows next to nothing


def test_the_checker_has_nothing_to_say_and_effects_can_be_chosen():
    check_env(gym.make(DESIGN, criterion=DISCRIMINATE).unwrapped, skip_render_check=True)
    env = ExcitationDesignVector(4, criterion=DISCRIMINATE, effects=["viscous_asymmetry", "cogging:order=7"])
    _, info = env.reset(seed=1)
    viscous, sin, cos = info["plant"][:, COUNT:].T
    assert ((viscous == 0) == ((sin != 0) & (cos != 0))).all() and env.single_observation_space.shape == (34,)


@pytest.mark.parametrize("name", [name for name in NAMES if name.startswith(DISCRIMINATE)])
def test_a_policy_that_ships_acts_as_in_the_environment_of_its_training(name):
    policy = load(name)
    env = ExcitationDesignVector(1, constraint=policy.constraint, criterion=DISCRIMINATE)
    pilot = Pilot(policy, policy.constraint, discriminates=policy.discriminates)
    observation, info = env.reset(seed=0)
    wanted = pilot.torque({"time": 0.0, "position": info["positions"][0, 0], "velocity": 0.0, "torque": 0.0})
    for k in range(50):
        observation, *_, info = env.step(policy.predict(observation)[0])
        assert wanted == pytest.approx(info["torque"][0], rel=1e-6)
        for j, (position, torque) in enumerate(zip(info["positions"][0], info["torques"][0], strict=True)):
            sample = {"time": (20 * k + j + 1) / 1000, "position": position, "velocity": 0.0, "torque": torque}
            wanted = pilot.torque(sample)


def test_a_hidden_effect_is_named_and_the_same_seed_says_the_same():
    policy = SEPARATING["two-tone"](CONSTRAINTS["peak"], 0)
    found = judge(policy, "peak", ["cogging"], 2, seed=3)
    assert found.hidden == ("cogging", "cogging") and (found.time < 15.0).all() and (found.group >= 1).all()
    assert found.rms == pytest.approx([3.0, 3.0], rel=0.2)
