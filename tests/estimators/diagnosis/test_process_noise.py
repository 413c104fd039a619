"""Torque noise that moves a joint and is not logged: it is no missing effect, and hides none."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import diagnose
from estimators.weak_form.process_noise import compute_white_p_values
from pendulum_env.recording import Recording
from tests import slow

PLANT = {"inertia": 0.18, "gravity": 4.8, "viscous": 0.31, "coulomb": 0.57}


def swing(seed: int, noise: float, rate: float = 100.0, **effects: dict[str, float]) -> Recording:
    """Record 20 s of a pendulum under two sines and white torque noise [N m], which is not logged."""
    experiment = Experiment(rate, 20.0, seed=seed, counts=65_536, torque_noise=noise, noise_in_plant=True)
    time = np.arange(experiment.samples) / rate
    command = 5.0 * np.sin(2 * np.pi * 0.4 * time + seed) + 4.0 * np.sin(2 * np.pi * 1.1 * time + 2 * seed)
    run = simulate([(Plant(**PLANT, effects=effects), experiment)], [command])[0]
    return Recording(run.time, run.position, run.command, name=f"run {seed}")


@pytest.mark.parametrize("seed", slow.but_first([1, 2, 3]))
def test_white_noise_of_the_torque_that_is_not_logged_is_no_missing_effect(seed):
    found = diagnose([swing(2 * seed, 0.15)], [swing(2 * seed + 1, 0.15)])
    assert found.evaluator is not None
    assert found.evaluator.residuals.relative_rms(found.model.terms) > 2.5
    assert found.selected == () and not found.unexplained
    for name, value in PLANT.items():
        own = found.model.estimates[name]
        assert abs(own.value - value) < 4 * own.std and not own.is_biased


def test_knocks_and_a_torque_that_wanders_are_no_noise_of_the_torque():
    knocks = {"knock_rate": 1.5, "knock_height": 3.0, "knock_width": 0.03}
    for effect in ({"knocks": knocks}, {"random_walk_torque": {"walk_rms": 0.2}}):
        found = diagnose([swing(2, 0.05, **effect)], [swing(3, 0.05, **effect)], only=["stribeck", "torque_offset"])
        assert found.unexplained


def test_p_values_of_white_noise_are_uniform_and_those_of_other_series_vanish():
    rng, place = np.random.default_rng(0), np.flatnonzero(np.arange(500) % 7 > 0)  # with gaps
    white = np.array([compute_white_p_values(rng.standard_normal(len(place)), place, 25) for _ in range(400)])
    np.testing.assert_allclose(np.mean(white < 0.05, axis=0), 0.05, atol=0.03)
    noise, time = rng.standard_normal(len(place)), place / 25.0
    for series, which in (
        (noise + 0.7 * np.sin(2.0 * time), 0),  # slow
        (noise * (1.0 + 0.7 * np.sin(0.5 * time)), 1),  # of changing variance
        (noise + 6.0 * (rng.random(len(place)) < 0.02), 2),  # with impacts
    ):
        assert compute_white_p_values(series, place, 25)[which] < 1e-3
