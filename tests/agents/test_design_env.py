"""The task of choosing an excitation: contracts, and what its reward and its observation say."""

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

from agents import DESIGN, load
from agents.design_env import ExcitationDesignVector
from agents.observer import CONSTRAINTS, INFORMATION_PRIOR, NOMINAL, TICK, Observer, decode_observation
from pendulum_env.plant import PAPER
from tests.runge_kutta import simulate_stick_slip

HELD = 20  # samples in a tick


def tones(step: int, count: int) -> np.ndarray:
    phase = np.arange(count)[:, None]
    return 0.5 * (np.sin(12.07 * step * TICK + phase) + np.sin(2.25 * step * TICK + 2 * phase))


def run(env, steps: int, seed: int = 0, action=tones) -> dict[str, np.ndarray]:
    observation, info = env.reset(seed=seed)
    rows = {"observation": [observation], "reward": [], "torque": [], "positions": [], "torques": []}
    for k in range(steps):
        observation, reward, _, _, info = env.step(action(k, env.num_envs))
        rows["observation"].append(observation)
        rows["reward"].append(reward)
        for name in ("torque", "positions", "torques"):
            rows[name].append(info[name])
    return {name: np.array(values) for name, values in rows.items()} | {"info": info}


def test_gymnasium_knows_it_by_its_conventions_without_torch():
    code = (
        f"import gymnasium, sys; id = 'agents:{DESIGN}'; "
        "env = gymnasium.make_vec(id, num_envs=3); print(env.reset(seed=0)[0].shape, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(3, 20) False"


def test_each_seed_of_a_list_matters():
    env = ExcitationDesignVector(2)
    seeds = ([5, 6], [5, 7], [5, None], 5, 5)
    first, *others, last, again = [env.reset(seed=seed)[1]["plant"]["gravity"][0] for seed in seeds]
    assert len({first, *others, last}) == 4 and last == again
    assert (
        ExcitationDesignVector(1).reset(seed=[5])[1]["plant"]["gravity"][0]
        == (ExcitationDesignVector(1).reset(seed=5)[1]["plant"]["gravity"][0])
    )


def test_information_is_the_sum_of_outer_products_of_rows_that_are_fast_enough():
    """Rows are means of the laws under a window over the tick that rises and falls over a quarter of it."""
    count, steps = 3, 200
    seen = run(ExcitationDesignVector(count, torque_noise=0.0), steps)
    q = np.concatenate([np.zeros((count, 1)), np.concatenate(list(seen["positions"]), axis=1)], axis=1)
    window = np.interp(np.arange(HELD + 1), [0, 5, 15, 20], [0.0, 1.0, 1.0, 0.0]) / 15
    M = np.tile(INFORMATION_PRIOR * np.eye(4), (count, 1, 1))
    for b in range(count):
        for k in range(steps):
            way = q[b, HELD * k : HELD * (k + 1) + 1]
            speed = 1000.0 * np.diff(way)
            if (speed >= 0.2).all() or (speed <= -0.2).all():
                acceleration = 1000.0 * np.sum(-np.diff(window) * speed)  # by parts
                velocity = np.sum(0.5 * (window[1:] + window[:-1]) * speed)
                row = np.array([acceleration, window @ np.sin(way), velocity, np.sign(speed[0])]) * NOMINAL
                M[b] += np.outer(row, row)
    np.testing.assert_allclose(seen["info"]["information"], M, rtol=1e-9, atol=1e-9)
    gained = np.linalg.slogdet(M)[1] - 4 * np.log(INFORMATION_PRIOR)
    np.testing.assert_allclose(seen["reward"].sum(axis=0), gained, rtol=1e-9)


@pytest.mark.parametrize("constraint", ["peak", "rms"])
def test_without_noise_the_estimates_are_the_parameters_of_the_plant(constraint):
    env, policy = ExcitationDesignVector(16, constraint=constraint, counts=0, torque_noise=0.0), load(constraint)
    observation, info = env.reset(seed=3)
    plant = info["plant"]
    for _ in range(250):
        observation, *_, info = env.step(policy.predict(observation)[0])
    for name in PAPER:
        np.testing.assert_allclose(info["estimates"][name] / plant[name], 1.0, atol=1e-4)
    alone = gym.make(DESIGN).reset(seed=3)[1]
    assert alone["estimates"] == pytest.approx(PAPER) and alone["plant"].keys() == alone["estimates"].keys()


@pytest.mark.parametrize("rate", [500.0, 1000.0])
def test_an_observer_finds_the_parameters_of_a_motion_of_another_integrator(rate):
    inertia, gravity, viscous, coulomb = 0.07, 2.4, 0.3, 1.1
    observer = Observer(CONSTRAINTS["peak"], 1.5, rate)
    command = np.repeat([6.0 * tones(k, 1)[0, 0] for k in range(75)], observer.samples_per_tick)
    position, *_ = simulate_stick_slip(
        lambda t, q, v, u: u - gravity * np.sin(q) - viscous * v, lambda *_: coulomb, inertia, command, 1 / rate
    )
    observer.start(np.zeros(1), np.zeros(1))
    for k in range(75):
        tick = slice(observer.samples_per_tick * k, observer.samples_per_tick * (k + 1))
        observer.add_tick(position[1:][tick, None], command[tick, None])
    found = observer.estimates[0] * NOMINAL
    np.testing.assert_allclose(found, [inertia, gravity, viscous, coulomb], rtol=1e-4)


def test_an_observation_can_be_read_back():
    env = ExcitationDesignVector(5)
    seen = run(env, 150)
    what = decode_observation(seen["observation"][-1])
    q = seen["positions"][-1][:, -1]
    np.testing.assert_allclose(np.exp(1j * what.position), np.exp(1j * q), atol=1e-6)
    np.testing.assert_allclose(what.information, seen["info"]["information"], rtol=1e-4, atol=1e-3)
    estimates = np.stack([seen["info"]["estimates"][name] for name in PAPER], axis=1)
    np.testing.assert_allclose(what.estimates * NOMINAL, estimates, atol=1e-5)
    np.testing.assert_allclose(what.time_left, 0.7, atol=1e-6)


def test_stick_teaches_nothing_and_is_told():
    env = ExcitationDesignVector(2)
    seen = run(env, 25, action=lambda k, count: np.full((count, 1), 0.05))
    assert not seen["reward"].any()
    assert (decode_observation(seen["observation"][-1]).is_stuck == 1).all()


def test_the_peak_and_the_budget_hold():
    seen = run(ExcitationDesignVector(2), 10, action=lambda k, count: np.full((count, 1), 7.0))
    assert np.abs(seen["torque"]).max() == 6.0
    env = ExcitationDesignVector(2, constraint="rms", seconds=2.0)
    seen = run(env, 100, action=lambda k, count: np.full((count, 1), (-1.0) ** (k // 7)))
    assert np.sqrt((seen["torque"] ** 2).mean(axis=0)) == pytest.approx(3.0)
    assert not seen["torque"][-50:].any()
    assert decode_observation(seen["observation"][-1]).budget_left == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "why"), [({"constraint": "peek"}, "mean peak"), ({"seconds": 0.0}, "episode of 0 s")]
)
def test_what_makes_no_sense_is_refused(arguments, why):
    with pytest.raises(ValueError, match=why):
        ExcitationDesignVector(1, **arguments)


def test_episodes_start_outside_of_stick_unless_they_start_at_rest():
    for start, gains in (("swing", True), ("rest", False)):
        env = ExcitationDesignVector(50, start=start)
        env.reset(seed=1)
        rewards = np.sum([env.step(np.zeros((50, 1), dtype=np.float32))[1] for _ in range(30)], axis=0)
        assert (rewards.min() > 1.0) if gains else (rewards == 0.0).all()
