"""The search where its first step misleads, on recordings of a simulator that shares no model code."""

import numpy as np

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators.diagnose import gather
from estimators.plausibility import beyond
from estimators.search import Search, look, no_progress
from pendulum_env.physics import BASE, effect
from pendulum_env.recording import Recording


def searched(plant: Plant, train: Experiment, test: Experiment) -> tuple[Search, list[str | None], float]:
    """The search, what it adds, and the share of the held-out torque error that is left."""
    runs = simulate([(plant, train), (plant, test)])
    recordings = [
        Recording(name, r.time, r.position, r.torque) for name, r in zip(("train", "test"), runs, strict=True)
    ]
    search, steps = look(*gather(recordings[:1], recordings[1:]), BASE, no_progress)
    old, new = (step.errors["holdout"].torque_rms for step in (steps[0], steps[-1]))
    return search, [step.added for step in steps[1:]], new / old


def test_an_effect_is_found_that_held_out_data_only_bear_out_beside_another():
    hidden = {"torque_offset": {"offset": -0.4}, "hard_stop": {"wall_q": 0.9, "wall_k": 60.0}}
    train, test = (Experiment(rate=500.0, seconds=10.0, seed=seed, excitation="multisine") for seed in (2, 3))
    search, found, left = searched(Plant(effects=hidden), train, test)
    assert len(search.grow([search.step(None, BASE)])) == 1  # neither alone lowers both held-out errors
    assert set(found) == set(hidden)
    assert left < 0.05


def test_a_torque_that_wanders_is_given_no_name():
    walk = {"random_walk_torque": {"walk_rms": 0.5}}
    train, test = (Experiment(rate=200.0, seconds=10.0, seed=seed, excitation="chirp") for seed in (2, 3))
    assert searched(Plant(effects=walk), train, test)[1] == []


def test_no_body_has_a_link_of_negative_inertia():
    terms = (*BASE, effect("joint_flexibility")())
    assert not beyond(terms, np.array([0.09, 2.0, 0.35, 0.8, 0.05]))
    ((column, value),) = beyond(terms, np.array([0.09, 2.0, 0.35, 0.8, -0.05]))
    assert (column.name, value) == ("joint_flexibility", -0.05)
