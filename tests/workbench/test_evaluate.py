"""`evaluate`: the same figures however many processes share the work."""

import json

import numpy as np
import pytest

from agents import load
from agents.evaluation import Outcome, evaluation_json
from workbench.commands.evaluate import show
from workbench.terminal import Terminal


def figures(done, policy, workers):
    """What an evaluation of a file writes, without computing time, and what it prints."""
    out = done("evaluate", policy, "--plants", "2", "--seed", "2", "--workers", workers, "--json", "figures.json")
    with open("figures.json", encoding="utf-8") as file:
        told = json.load(file)
    assert all(own.pop("seconds_per_action") > 0 for own in told["policies"].values())
    return told, out


@pytest.fixture
def policy(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    load("peak").save("policy.npz")
    return "policy.npz"


def test_every_policy_is_printed_beside_the_baseline(done, policy):
    told, out = figures(done, policy, 1)
    assert list(told["policies"]) == ["two-tone", policy]
    assert told["policies"]["two-tone"]["gain"]["information"]["ratio"] == pytest.approx(1.0)
    for own in told["policies"].values():
        assert all(f"{100 * middle:.3f} (" in out for _, middle, _ in own["error"].values())
        assert f"{own['gain']['information']['ratio']:.2f} (" in out


@pytest.mark.slow
def test_processes_give_the_same_figures(done, policy):
    assert figures(done, policy, 2)[0] == figures(done, policy, 1)[0]


def test_what_a_policy_never_reaches_is_told_without_a_number(capsys):
    def outcome(log_det: float, error: float) -> Outcome:
        course, none = np.full((500, 4), error), np.zeros((500, 4))
        return Outcome(course, course, none + log_det, np.full((3, 4), 1e-4), none, none, np.ones(4), 1e-3)

    outcomes = {"two-tone": outcome(0, 2e-3), "a": outcome(4, 1e-3), "b": outcome(2, 2e-2)}
    setting = {"plants": 4, "constraint": "peak", "scheme": "energy", "effects": (), "spread": 0.3}
    figures = evaluation_json(outcomes, "two-tone", **setting)
    sooner, never = (figures["policies"][name]["gain"] for name in ("a", "b"))
    assert sooner["information"]["ratio"] == pytest.approx(np.exp(4 / 4))
    assert (sooner["error 2 s"]["ratio"], never["error 2 s"]["ratio"]) == pytest.approx((2.0, 0.1))
    assert never["time to 1 %"]["ratio"] is None
    show(figures, Terminal())
    assert "nan" not in capsys.readouterr().out
