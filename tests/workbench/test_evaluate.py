"""`evaluate`: the same figures however many processes share the work."""

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import A2C

from agents import DESIGN, load
from agents.comparison import PolicyComparison
from agents.evaluation import Outcome
from workbench.commands.evaluate import print_figures
from workbench.terminal import Terminal


def figures(run_command, policy, workers, *more):
    """What an evaluation of a file writes, without computing time, and what it prints."""
    out = run_command(
        "evaluate", policy, *more, "--plants", "2", "--seed", "2", "--workers", workers, "--json", "figures.json"
    )
    with open("figures.json", encoding="utf-8") as file:
        told = json.load(file)
    assert all(own.pop("seconds_per_action") > 0 for own in told["policies"].values())
    return told, out


@pytest.fixture
def policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    load("peak").save("policy.npz")
    return "policy.npz"


def test_a_file_and_an_own_class_around_a_model_of_stable_baselines_are_printed_beside_the_baseline(
    run_command, policy
):
    """The model always plays nothing, so it learns nothing."""
    lines = (
        "from stable_baselines3 import A2C",
        "class Model:",
        "    def __init__(self):",
        "        self.predict = A2C.load('model.zip', device='cpu').predict",
    )
    Path("own_class_of_a_test.py").write_text("\n".join(lines))
    model = A2C("MlpPolicy", gym.make(DESIGN), device="cpu", policy_kwargs={"net_arch": [4]})
    with torch.no_grad():
        for parameter in model.policy.action_net.parameters():
            parameter.zero_()
    model.save("model.zip")
    told, out = figures(run_command, policy, 1, "own_class_of_a_test:Model")
    assert list(told["policies"]) == ["two-tone", policy, "own_class_of_a_test:Model"]
    assert [own["torque_peak"] > 0 for own in told["policies"].values()] == [True, True, False]
    assert told["policies"]["two-tone"]["gain"]["information"]["ratio"] == pytest.approx(1.0)
    for own in (told["policies"][name] for name in ("two-tone", policy)):
        assert all(f"{100 * rms['error']:.4f}" in out for rms in own["rms"].values())
        assert all(f"{100 * rms['bound']:.4f}" in out for rms in own["rms"].values())
        assert f"{own['gain']['information']['ratio']:.2f} (" in out


@pytest.mark.slow
def test_processes_give_the_same_figures(run_command, policy):
    assert figures(run_command, policy, 2)[0] == figures(run_command, policy, 1)[0]


def test_what_a_policy_never_reaches_is_told_without_a_number(capsys):
    def outcome(log_det: float, error: float) -> Outcome:
        none = np.zeros((500, 4))
        return Outcome(
            np.full((500, 4, 4), error),
            none + log_det,
            np.full((3, 4), 1e-4),
            none,
            none,
            np.ones(4),
            np.ones(4),
            np.full((3, 6, 4), error),
            np.zeros((500, 4, 3), dtype=bool),
            1e-3,
        )

    outcomes = {"two-tone": outcome(0, 2e-3), "a": outcome(4, 1e-3), "b": outcome(2, 2e-2)}
    setting = {"plants": 4, "constraint": "peak", "scheme": "energy", "effects": (), "spread": 0.3}
    comparison = PolicyComparison(outcomes, setting)
    figures = print_figures(comparison, Terminal())
    sooner, never = (figures["policies"][name]["gain"] for name in ("a", "b"))
    assert sooner["information"]["ratio"] == pytest.approx(np.exp(4 / 4))
    assert (sooner["error 2 s"]["ratio"], never["error 2 s"]["ratio"]) == pytest.approx((2.0, 0.1))
    assert never["time to 1 %"]["ratio"] is None
    assert "nan" not in capsys.readouterr().out
