"""The example of a policy from simulation to a joint: its task is what it says, and it learns."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

EXAMPLE = Path(__file__).parents[2] / "examples" / "sim_to_real.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("sim_to_real", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["sim_to_real"] = module  # dataclasses look there
    spec.loader.exec_module(module)
    yield module
    del sys.modules["sim_to_real"]


def test_the_error_is_the_distance_to_a_target_that_changes_with_the_episode(example):
    env = example.joints(example.make_plant(effects=example.HIDDEN), 3)
    first, _ = env.reset(seed=1)
    targets = env.target.copy()
    np.testing.assert_allclose(first[:, 0], targets, rtol=1e-6)  # it hangs at 0
    for _ in range(round(example.SECONDS * example.RATE) - 1):
        seen, reward, _, truncated, info = env.step(np.full((3, 1), 0.5))
        np.testing.assert_allclose(env.error, np.abs(info["position"] - targets))
        assert not truncated.any() and (reward < 0).all()
    seen, _, _, truncated, info = env.step(np.full((3, 1), 0.5))
    assert truncated.all()
    np.testing.assert_allclose(np.abs(info["final_obs"][:, 0]), env.error, rtol=1e-5)
    assert not np.any(env.target == targets)
    np.testing.assert_allclose(seen[:, 0], env.target, rtol=1e-6)


def test_a_short_training_brings_the_joint_closer(example, monkeypatch):
    monkeypatch.setattr(example, "TRIALS", 32)
    plant = example.make_plant(effects=example.HIDDEN)
    errors = []
    for steps in (1, 30_000):
        monkeypatch.setattr(example, "STEPS", steps)
        errors.append(example.evaluate(example.train(plant, seed=0), plant, seed=0))
    assert errors[1] < 0.9 * errors[0]


def test_an_interval_covers_the_mean_as_often_as_it_says(example):
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(2000):
        middle, half = example.interval(list(rng.normal(3.0, 1.0, 5)))
        covered += abs(middle - 3.0) < half
    assert covered / 2000 == pytest.approx(0.95, abs=0.015)
