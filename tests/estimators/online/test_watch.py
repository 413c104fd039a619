"""A watch tells a changed value from a wrong structure, when and where, and is silent while the model holds.

Plants come from the independent integrator; one that changes goes on from where it was. Sizes are those that should
show; how often smaller ones do is measured by `benchmarks.watching`.
"""

import pickle
from dataclasses import replace
from functools import cache

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.excitation import OPEN_LOOP
from benchmarks.independent_plant import Experiment, Plant, simulate
from benchmarks.watching import CHANGE, changing, watched
from estimators.online import Verdict, Watch
from estimators.signals.measurements import Smoothing
from estimators.wrappers import EstimateParameters, WatchModel, WatchModelVector
from pendulum_env.physics import BASE, Model
from pendulum_env.registration import PENDULUM
from pendulum_env.wrappers import RandomizePlant
from tests.feeding import fed, played

RATE, COUNTS = 500.0, 65_536
BEFORE = Plant()
HEAVIER = replace(BEFORE, inertia=0.12, gravity=2.5)
HIDDEN = {
    "torque_offset": {"offset": 0.3},
    "quadratic_drag": {"drag": 0.04},
    "cogging": {"cog_n": 12.0, "cog_s": 0.3},
    "stribeck": {"strib_d": 0.7, "strib_v": 0.5},
}


@cache
def all_told() -> dict[str, list[list[tuple[float, Verdict]]]]:
    """By what sets in: the course of two runs. All are watched at once, which takes hardly longer than one."""
    plants = {"payload": HEAVIER} | {id: replace(BEFORE, effects={id: law}) for id, law in HIDDEN.items()}
    experiment = Experiment(rate=RATE, seconds=8.0, counts=COUNTS, torque_noise=0.05)
    experiments = [replace(experiment, seed=seed, excitation=e) for seed, e in enumerate(("two_tone", "steps"))]
    courses = watched(changing([(BEFORE, plant, e) for plant in plants.values() for e in experiments]), RATE, COUNTS)
    return {after: courses[2 * k : 2 * k + 2] for k, after in enumerate(plants)}


def told(after: str) -> list[list[tuple[float, Verdict]]]:
    return all_told()[after]


@pytest.mark.parametrize("effect", HIDDEN)
def test_an_effect_that_sets_in_is_structure_within_five_seconds(effect):
    for course in told(effect):
        assert not any(verdict.alarms for t, verdict in course if t < CHANGE)
        kinds = [(t, verdict) for t, verdict in course if verdict.kind == "structure"]
        assert kinds and kinds[0][0] < CHANGE + 5.0
        assert course[-1][1].kind == "structure" and course[-1][1].where
        if effect == "quadratic_drag":  # where the joint is fast, or with the torque that drives it
            assert set(course[-1][1].where) <= {"velocity", "torque"}


def test_friction_that_changes_at_low_speed_shows_where_the_joint_turns():
    where = [verdict.where for _, verdict in told("stribeck")[0] if verdict.kind == "structure"]
    lowest, highest = where[0]["velocity"]
    assert lowest == -highest < 0


def test_a_payload_is_two_values_with_their_time_and_size():
    for course in told("payload"):
        last = course[-1][1]
        assert last.kind == "value" and last.alarms == 1
        assert set(last.changes) == {"inertia", "gravity"} and last.parameter in last.changes
        assert last.since == pytest.approx(CHANGE, abs=0.3)
        for name, true in (("inertia", 0.03), ("gravity", 0.5)):
            change, std = last.changes[name]
            assert change == pytest.approx(true, rel=0.1) and 0 < std < 0.25 * true


@pytest.mark.slow
def test_a_plant_that_holds_and_one_that_drifts_slowly_are_not_alarmed_about():
    """Six minutes in all; friction that falls by a tenth over a minute is a walk that the model may take."""
    drift = {"friction_drift": {"drift_a": 0.1, "drift_T": 60.0}}
    plants = [BEFORE] * 4 + [replace(BEFORE, effects=drift)] * 2
    cases = [
        (plant, Experiment(rate=200.0, seconds=60.0, seed=seed, counts=8192, torque_noise=0.05))
        for seed, plant in enumerate(plants)
    ]
    runs = [(run.time, run.position, np.r_[0.0, run.torque[:-1]]) for run in simulate(cases)]
    last = [course[-1][1] for course in watched(runs, 200.0, 8192)]
    assert [verdict.kind for verdict in last] == ["predicts"] * 6
    assert all(verdict.alarms == 0 and verdict.score < verdict.threshold for verdict in last)


def test_a_wrapper_watches_beside_others_and_a_reset_begins_anew():
    env = WatchModel(EstimateParameters(RandomizePlant(gym.make(PENDULUM, rate=200), 0.1), schemes="dynamic"))
    again = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    for one in (env, again):
        one.reset(seed=0)
        first, *_, last = played(one, 1600)
        assert first["watch"].kind == "calibrating" and last["watch"].kind == "predicts"
        assert "dynamic" in last["estimates"]
    copy = pickle.loads(pickle.dumps(env))
    assert played(copy, 50, 1600)[-1]["watch"] == played(env, 50, 1600)[-1]["watch"]
    _, info = env.reset()
    assert info["watch"].kind == "calibrating"


def test_a_model_that_is_given_is_compared_with_the_plant_as_it_is(tmp_path):
    """One whose gravity is a fifth too small is found out at once; `accept` takes the plant as it is."""
    theta = np.array([0.0895, 2.01, 0.3638, 0.9163])
    env = gym.make(PENDULUM, rate=200, substeps=5, torque_noise=0.05)
    for factor, kind in ((1.0, "predicts"), (0.8, "value")):
        Model.build(BASE, theta * [1.0, factor, 1.0, 1.0]).save(tmp_path / "model.json")
        one = WatchModel(env, tmp_path / "model.json")
        one.reset(seed=0)
        *_, info = played(one, 3000)
        assert info["watch"].kind == kind
    assert info["watch"].parameter == "gravity"
    assert info["watch"].changes["gravity"][0] == pytest.approx(0.4, rel=0.05)
    one.accept()
    assert played(one, 2400, 3000)[-1]["watch"].kind == "predicts"
    with pytest.raises(ValueError, match="either model or terms"):
        WatchModel(env, Model.build(BASE, theta), terms=["inertia"])


def test_many_are_watched_like_one():
    env = WatchModelVector(gym.make_vec(PENDULUM, num_envs=2, rate=200.0, torque_noise=0.05))
    _, info = env.reset(seed=0)
    assert [verdict.kind for verdict in info["watch"]] == ["calibrating"] * 2
    assert [verdict.kind for verdict in played(env, 1500)[-1]["watch"]] == ["predicts"] * 2


@pytest.mark.parametrize("rate", [2.0, 20.0, 200.0])
def test_a_free_swing_that_dies_out_is_no_alarm_at_any_rate(rate):
    watch = Watch(rate)
    for t in np.arange(0.0, 30.0, 1 / rate):
        (verdict,) = watch.take(np.array([t]), np.array([np.exp(-t / 8) * np.cos(4.5 * t)]), np.zeros(1))
    assert verdict.kind in ("predicts", "calibrating" if rate < 100 else "") and not verdict.alarms


def test_bad_options_are_refused():
    for rate in (0.0, -5.0, np.nan):
        with pytest.raises(ValueError, match="the rate cannot be"):
            Watch(rate)
    with pytest.raises(ValueError, match="alarms_per_hour"):
        Watch(RATE, alarms_per_hour=0.0)
    with pytest.raises(ValueError, match="theta has 2 values, the model 4"):
        Watch(RATE, theta=[1.0, 2.0])


@pytest.mark.slow
def test_a_gap_is_no_alarm():
    """The joint goes on while nobody looks: what is missing between two samples is not a torque."""
    experiment = Experiment(rate=RATE, seconds=12.0, counts=COUNTS, torque_noise=0.05, seed=4)
    (run,), watch = simulate([(BEFORE, experiment)]), Watch(RATE, calibrate=4.0)
    for first, last in ((0.0, 5.002), (5.5, 8.002), (8.01, 12.0)):
        ((verdict,), *_) = reversed(fed(watch, run, round(first * RATE), round(last * RATE)))
    assert verdict.kind == "predicts"


@pytest.mark.slow
def test_a_changed_value_becomes_the_models_and_the_next_change_is_told_too():
    """A payload is picked up, and put down again thirteen seconds later."""
    seconds, start, told = 13.0, (0.0, 0.0), []
    watch = Watch(RATE, smoothing=Smoothing.of_encoder(COUNTS, RATE))
    count = round(seconds * RATE)
    command = OPEN_LOOP["two_tone"](np.random.default_rng(0), np.arange(3 * count + 1) / RATE, 1.0)
    held = 0.0
    for part, plant in enumerate((BEFORE, HEAVIER, BEFORE)):
        experiment = Experiment(RATE, seconds + 1 / RATE, seed=part, counts=COUNTS, torque_noise=0.05, start=start)
        (run,) = simulate([(plant, experiment)], [command[part * count : (part + 1) * count + 1]])
        start = float(run.exact_position[-1]), float(run.velocity[-1])
        for k in range(count):
            sample = part * seconds + k / RATE, run.position[k], held
            (verdict,), held = watch.take(*(np.full(1, value) for value in sample)), run.torque[k]
        told.append((verdict.kind, verdict.alarms, *(change for change, _ in verdict.changes.values())))
    assert [one[:2] for one in told] == [("predicts", 0), ("value", 1), ("value", 2)]
    np.testing.assert_allclose(np.sort(told[1][2:]), [0.03, 0.5], rtol=0.05)
    np.testing.assert_allclose(np.sort(told[2][2:]), [-0.5, -0.03], rtol=0.05)
