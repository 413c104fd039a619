"""Comparison of policies: every form of a policy plays the same, and what does not fit is refused."""

from concurrent.futures import ThreadPoolExecutor

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import A2C, SAC

from agents import DESIGN, compare_policies, load
from agents.baselines import BASELINES
from agents.comparison import compute_bootstrap_interval, compute_gain, compute_information_ratio
from agents.contenders import load_class, make_contender
from agents.observer import TICK
from pendulum_env.excitation import TwoTone
from tests.once import once

PHASES = (0.4, 1.3)


def torque(time: float) -> float:
    """Two tones [N m]."""
    return 3.0 * np.sin(12.07 * time + PHASES[0]) + 3.0 * np.sin(2.25 * time + PHASES[1])


class Player:
    """The two tones as a class that knows the time from its observation only, and takes no state."""

    def predict(self, observation, deterministic=True):
        tick = np.rint((1.0 - observation[:, 17].astype(float)) * 500)
        return torque(TICK * tick)[:, None] / 6.0


def answers(answer):
    """A policy that always returns the same."""

    class Constant:
        def predict(self, observation, state=None, **_):
            return answer(len(observation)), state

    return Constant()


class Mixed:
    """Nothing on a third of the plants, much more than the peak on another, and the peak on the last."""

    def predict(self, observation):
        return np.repeat([0.0, -6.0, 1.0], len(observation) // 3)


STILL, STRONG, FULL = slice(0, 20), slice(20, 40), slice(40, 60)


@pytest.fixture(scope="module")
@once("pendulum_env", "estimators", "agents")
def found():
    """Two forms of the two tones, and a policy that does not fit, beside the baseline."""
    return compare_policies({"class": Player, "mine": torque, "mixed": Mixed}, ["two-tone"], plants=60, seed=3)


def test_a_class_and_a_function_play_the_same(found):
    forms = ("class", "mine")
    assert list(found.outcomes) == ["two-tone", *forms, "mixed"]
    time = TICK * np.arange(500)
    for name in forms:
        np.testing.assert_allclose(found.outcomes[name].torque, np.tile(torque(time)[:, None], 60), atol=2e-6)
        np.testing.assert_allclose(found.outcomes[name].error, found.outcomes["class"].error, rtol=1e-3)
    own, base = found.outcomes["mine"], found.outcomes["two-tone"]
    mine = found.json()["policies"]["mine"]
    rms = np.sqrt((own.parameter_errors[99] ** 2).mean(axis=1))
    assert mine["error"]["2 s"][1] == pytest.approx(np.quantile(rms, 0.5, method="closest_observation"))
    assert mine["gain"]["error 10 s"]["ratio"] == pytest.approx(np.median(base.error[-1]) / np.median(own.error[-1]))
    assert max(np.median(found.outcomes[name].errors[-1]) for name in ("two-tone", *forms)) < 0.005


def test_an_excitation_plays_as_a_function():
    """What they return depends on the time alone, so that their errors are the same, too."""
    excitation, mine = (make_contender("own", own, "peak")(0) for own in (TwoTone(6.0, PHASES), torque))
    states = [None, None]
    for tick in range(500):
        begun = np.full(3, tick == 0)
        (one, states[0]), (two, states[1]) = (
            policy.predict(np.zeros((3, 20)), state, begun)
            for policy, state in zip((excitation, mine), states, strict=True)
        )
        np.testing.assert_allclose(one, two, atol=1e-7)
        np.testing.assert_allclose(6.0 * two, np.full((3, 1), torque(TICK * tick)), atol=2e-6)


def test_a_policy_that_moves_no_joint_or_asks_for_more_than_the_peak_is_noted(found):
    mixed = found.outcomes["mixed"]
    assert np.all(mixed.speed[STILL] == 0) and np.all(mixed.speed[FULL] > 0) and np.all(mixed.action[STRONG] == 6.0)
    still, strong = found.notes
    angle, speed, asked = np.moveaxis(mixed.violated, 2, 0)
    assert not mixed.violated[:, STILL].any() and asked[:, STRONG].all()
    # 6 N m turn the joint by about 10 rad/s: a turn is complete within a second, 25 rad/s are not reached
    assert 0.9 < angle[:, FULL].mean() < 1.0
    assert not speed[:, FULL].any() and not asked[:, FULL].any()
    told = found.json()["policies"]["mixed"]["violations"]
    assert [told[name] for name in ("angle", "speed", "torque", "any")] == pytest.approx(
        [angle.mean(), speed.mean(), asked.mean(), mixed.violated.any(axis=2).mean()]
    )
    assert still.startswith("mixed never moves the joint on 20 of 60 plants") and "asks for up to 6.0 times" in strong


def test_a_model_of_stable_baselines_is_a_policy():
    model = SAC("MlpPolicy", gym.make(DESIGN), seed=1, device="cpu", policy_kwargs={"net_arch": [8]})
    observation, begun = np.random.default_rng(0).uniform(-1, 1, (5, 20)).astype(np.float32), np.ones(5, dtype=bool)
    action, _ = make_contender("mine", model, "peak")(0).predict(observation, None, begun, deterministic=True)
    assert np.ptp(action) > 0
    np.testing.assert_array_equal(action, model.predict(observation, deterministic=True)[0])


def test_a_policy_that_does_not_fit_is_refused():
    a2c = A2C("MlpPolicy", "Pendulum-v1", device="cpu")
    for policies, baselines, why in (
        ({"mine": 3.0}, [], "policy mine is 3.0: give"),
        ({"mine": lambda time: 7.0}, [], "signal mine reaches 7 N m: keep it within the peak of 6 N m"),
        ({"mine": lambda time: {}["a"]}, [], "signal mine fails: KeyError"),
        ({"mine": load("rms")}, [], "was trained under the constraint rms, not peak"),
        ({"mine": answers(lambda batch: np.zeros(1))}, [], r"return finite numbers of shape \(2, 1\)"),
        ({"mine": answers(lambda batch: np.full((batch, 1), np.nan))}, [], "return finite numbers"),
        ({"mine": answers(lambda batch: 1 / 0)}, [], "policy mine fails: ZeroDivisionError"),
        ({"mine": a2c}, [], "policy mine fails: "),
        ({"mine": "two-tone"}, [], "policy mine is 'two-tone': give"),
        ({"two-tone": torque}, ["two-tone"], "both called two-tone"),
        ({}, ["two_tone"], "did you mean two-tone"),
        ({}, [], "nothing to compare"),
    ):
        with pytest.raises(ValueError, match=why):
            compare_policies(policies, baselines, plants=2)


def test_a_class_is_found_in_a_module_of_the_current_folder(tmp_path, monkeypatch):
    (tmp_path / "own_policy_of_a_test.py").write_text("class Mine:\n    def predict(self, observation): ...\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # put back afterwards
    assert load_class("own_policy_of_a_test:Mine").__name__ == "Mine"
    for text, why in (("own_policy_of_a_test:Yours", "has no class Yours"), ("no_such_module:A", "import .* fails")):
        with pytest.raises(ValueError, match=why):
            load_class(text)


def test_ratios_and_their_intervals():
    rng = np.random.default_rng(0)
    base = rng.lognormal(0.0, 0.3, 400)
    policy = base / 2 * rng.lognormal(0.0, 0.05, 400)
    low, high = compute_bootstrap_interval(compute_gain, policy, base)
    assert low < compute_gain(policy, base) < high
    assert compute_gain(policy, base) == pytest.approx(2.0, rel=0.1)
    assert compute_information_ratio(np.full(3, 4 * np.log(2.5)), np.zeros(3)) == pytest.approx(2.5)
    assert np.isnan(compute_gain(np.full(4, np.inf), base))
    nothing = np.full(len(base), -np.inf)  # det M = 0
    assert np.isnan(compute_information_ratio(nothing, nothing)) and compute_information_ratio(nothing, base) == 0.0


@pytest.mark.slow
def test_where_it_is_worked_out_changes_nothing(monkeypatch):
    monkeypatch.setattr("agents.comparison.PLANTS_PER_JOB", 2)
    here = compare_policies({}, [*BASELINES][:1], plants=3, seed=1)
    with ThreadPoolExecutor(2) as pool:
        there = compare_policies({}, [*BASELINES][:1], plants=3, seed=1, executor=pool)
    for name, outcome in here.outcomes.items():
        assert outcome.errors.shape == (3, 3)
        np.testing.assert_array_equal(outcome.error, there.outcomes[name].error)
        assert not np.allclose(outcome.torque[:, 0], outcome.torque[:, 2])  # signals differ between parts


def test_the_table_has_bound_error_and_their_ratio_with_its_interval(found):
    """The RMS of the errors over the plants, whose ratio to the bound is near 1 for the linear schemes only."""
    policies, table = found.json()["policies"], str(found)
    for name in ("two-tone", "class", "mine"):
        outcome, told = found.outcomes[name], policies[name]
        for k, rms in enumerate(told["rms"].values()):
            assert rms["error"] == pytest.approx(np.sqrt(np.mean(outcome.errors[k] ** 2)))
            assert rms["bound"] == pytest.approx(np.sqrt(np.mean(outcome.bound[k] ** 2)))
            ratio = rms["error_over_bound"]
            assert ratio["ratio"] == pytest.approx(rms["error"] / rms["bound"]) and ratio["low"] < 1.25
            assert ratio["low"] < ratio["ratio"] < ratio["high"] < 1.6
            assert rms["schemes"]["filtered_dynamic"] == pytest.approx(ratio["ratio"])
            assert rms["schemes"]["energy"] > 1.5
        assert f"{100 * told['rms']['10 s']['bound']:.4f}" in table
