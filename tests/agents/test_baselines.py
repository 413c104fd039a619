"""Signals and planners that a trained policy is compared with."""

import numpy as np
import pytest

from agents.baselines import (
    BASELINES,
    FREQUENCIES,
    load_weights,
    make_baseline,
    make_multisine_torque,
    predict_rows,
)
from agents.design_env import ExcitationDesignVector
from agents.observer import CONSTRAINTS, NOMINAL, compute_log_det
from benchmarks.multisine import PAPER, mean_log_det


def play(name: str, constraint: str, count: int = 3, steps: int = 60):
    env = ExcitationDesignVector(count, constraint=constraint)
    policy, state = make_baseline(name, constraint, seed=4), None
    observation, _ = env.reset(seed=2)
    torques = []
    for k in range(steps):
        action, state = policy.predict(observation, state, np.full(count, k == 0))
        assert action.shape == (count, 1)
        assert env.action_space.contains(action)
        observation, _, _, _, info = env.step(action)
        torques.append(info["torque"])
    return np.array(torques), info


@pytest.mark.parametrize("constraint", CONSTRAINTS)
@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_plays_within_the_constraint_and_repeats(name, constraint):
    torques, _ = play(name, constraint, steps=20)
    assert np.abs(torques).max() <= CONSTRAINTS[constraint].peak + 1e-6
    np.testing.assert_array_equal(torques, play(name, constraint, steps=20)[0])


def test_signals_spend_the_whole_budget_and_differ_between_pendulums():
    policy, state, shares = make_baseline("two-tone", "rms", seed=4), None, []
    for k in range(500):
        action, state = policy.predict(np.zeros((2, 20)), state, np.full(2, k == 0))
        shares.append(action[:, 0])
    torques = CONSTRAINTS["rms"].peak * np.array(shares)
    np.testing.assert_allclose(np.sqrt((torques**2).mean(axis=0)), 3.0, rtol=1e-6)
    assert not np.allclose(torques[:, 0], torques[:, 1])


def test_looking_ahead_foresees_what_will_be_learnt():
    """The rows that it simulates with the true parameters are those that the environment then measures."""
    env = ExcitationDesignVector(4, torque_noise=0.0, spread=0.0, start="rest")
    env.reset(seed=0)
    torque = np.concatenate([np.full((10, 4, 1), 6.0), np.full((10, 4, 1), -6.0)])
    theta = env.pendulums.theta.T
    rows, usable = predict_rows(torque, theta, np.zeros(4), np.zeros(4))
    rows = (rows * usable[..., None])[:, :, 0]
    before, compared = 0.1 * np.eye(4), 0
    for k in range(20):
        info = env.step(torque[k] / 6.0)[-1]
        learnt = info["information"] - before
        before = info["information"]
        measured = np.sqrt(np.einsum("bii->bi", learnt))
        if usable[k].all() and measured.all():  # at the limit of what is fast enough they may differ
            np.testing.assert_allclose(measured, np.abs(rows[k]), rtol=0.06, atol=0.03)
            compared += 1
    assert compared >= 14


def test_looking_ahead_learns_more_than_the_papers_signal():
    states = [play(name, "peak", steps=100)[1] for name in ("look-ahead", "two-tone")]
    ahead, paper = (compute_log_det(state["information"]) for state in states)
    assert np.exp((ahead - paper).mean() / 4) > 1.5


@pytest.mark.parametrize("constraint", CONSTRAINTS)
def test_a_multisine_found_in_advance_teaches_more_than_the_papers_tones(constraint):
    theta = NOMINAL * (1 + np.random.default_rng(99).uniform(-0.3, 0.3, (20, 4)))  # other plants than it was found on
    paper = np.zeros(2 * len(FREQUENCIES))
    paper[list(PAPER)] = 1.0
    signals = np.column_stack([paper, load_weights(constraint)])
    first, better = mean_log_det(signals, theta, CONSTRAINTS[constraint])
    assert better > first + 0.3
    torque = make_multisine_torque(signals, CONSTRAINTS[constraint])
    assert np.abs(torque).max() <= CONSTRAINTS[constraint].peak + 1e-9
    if constraint == "rms":
        assert np.sqrt(np.mean(torque**2, axis=0)) == pytest.approx(3.0)
