"""Policies from simulation to a joint: the task is what it says, is the same on both, and can be learnt."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from benchmarks import sim_to_real as benchmark
from pendulum_env.plant import make_plant

KNOWN = make_plant(effects=["stribeck=0.45,0.5", "load_dependent_friction=0.2", "dead_time=0.02"])
PERIODS = round(benchmark.SECONDS * benchmark.RATE)


class Servo:
    """A policy that pushes towards the target, and brakes."""

    def predict(self, seen, deterministic):
        return np.clip(3.0 * seen[:, :1] - 0.4 * seen[:, 3:4] + 0.2 * seen[:, 5:], -1.0, 1.0), None


def test_the_error_is_the_distance_to_a_target_that_changes_with_the_episode():
    env = benchmark.Reach(benchmark.joints(KNOWN, 3, PERIODS))
    first, _ = env.reset(seed=1)
    targets = env.target.copy()
    np.testing.assert_allclose(first[:, 0], targets, rtol=1e-6)  # it hangs at 0
    push = np.full((3, 1), 0.5)
    for _ in range(PERIODS - 1):
        seen, reward, _, truncated, info = env.step(push)
        np.testing.assert_allclose(env.error, np.abs(info["position"] - targets))
        assert not truncated.any() and (reward < 0).all() and (seen[:, 5] == 0.5).all()
    seen, _, _, truncated, info = env.step(push)
    assert truncated.all()
    np.testing.assert_allclose(np.abs(info["final_obs"][:, 0]), env.error, rtol=1e-5)
    assert not np.any(env.target == targets)
    np.testing.assert_allclose(seen[:, 0], env.target, rtol=1e-6)
    assert not seen[:, 5].any()


def test_where_model_and_joint_are_the_same_so_is_the_motion_in_training_in_the_simulator_and_on_the_joint():
    env, policy = benchmark.Reach(benchmark.joints(KNOWN, 5, PERIODS)), Servo()
    seen, info = env.reset(seed=2)
    target, trained = env.target.copy(), [info["position"]]
    while len(trained) < PERIODS:
        seen, *_, info = env.step(policy.predict(seen, True)[0])
        trained.append(info["position"])
    simulated = benchmark.in_simulator(KNOWN, 5, benchmark.controller(policy, target))
    np.testing.assert_allclose(simulated, trained, atol=1e-5)  # observations are float32
    real = benchmark.on_joint(5, benchmark.controller(policy, target))
    np.testing.assert_allclose(real, simulated, atol=2e-3)
    assert np.ptp(real, axis=0).max() > 0.3


def test_a_short_training_brings_a_joint_without_much_friction_closer():
    easy, target = make_plant({"coulomb": 0.1}), np.linspace(-1.0, 1.0, 32)
    short, longer = (
        benchmark.Tried.of(partial(benchmark.in_simulator, easy), benchmark.train(easy, 0, steps=steps), target)
        for steps in (1, 15_000)
    )
    assert longer.error < 0.7 * short.error
