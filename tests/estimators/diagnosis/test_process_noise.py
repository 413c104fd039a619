"""Torque noise that moves a joint and is not logged: it is no missing effect, and hides none."""

from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import diagnose, identify
from estimators.diagnosis.completeness import Incomplete
from estimators.findings import Finding
from estimators.selection.process_noise import UnloggedTorque, bound_hidden_effect, compute_white_p_values
from pendulum_env.recording import Recording
from tests import slow

PLANT = {"inertia": 0.18, "gravity": 4.8, "viscous": 0.31, "coulomb": 0.57}


def swing(seed: int, noise: float, rate: float = 100.0, hidden: float = 0.0, **effects: dict[str, float]) -> Recording:
    """Record 20 s of a pendulum under two sines; white noise and a slow sine (RMS) [N m] are not logged."""
    experiment = Experiment(rate, 20.0, seed=seed, counts=65_536, torque_noise=noise, noise_in_plant=True)
    time = np.arange(experiment.samples) / rate
    command = 5.0 * np.sin(2 * np.pi * 0.4 * time + seed) + 4.0 * np.sin(2 * np.pi * 1.1 * time + 2 * seed)
    slow = np.sqrt(2.0) * hidden * np.sin(2 * np.pi * 0.23 * time + seed)
    run = simulate([(Plant(**PLANT, effects=effects), experiment)], [command + slow])[0]
    return Recording(run.time, run.position, run.command - slow, name=f"run {seed}")


def find_noise(findings: Sequence[Finding]) -> list[Finding]:
    return [finding for finding in findings if isinstance(finding, UnloggedTorque)]


@pytest.mark.parametrize("seed", slow.but_first([1, 2, 3]))
def test_white_noise_of_the_torque_that_is_not_logged_is_no_missing_effect(seed):
    found = diagnose([swing(2 * seed, 0.15)], [swing(2 * seed + 1, 0.15)])
    assert found.evidence is not None
    assert found.evidence.residuals.relative_rms(found.model.terms) > 2.5
    assert found.selected == () and not found.unexplained
    (noise,) = find_noise(found.findings)
    assert noise.torque.value == pytest.approx(0.15, rel=0.1)
    assert 0.0 < noise.hidden.value < 0.1
    for name, value in PLANT.items():
        own = found.model.estimates[name]
        assert abs(own.value - value) < 4 * own.std and not own.is_biased


def test_identify_reports_noise_that_is_not_logged_and_trusts_its_estimates():
    results = identify([swing(2, 0.15)])
    (noise,) = results.findings
    assert find_noise([noise]) and noise.torque.value == pytest.approx(0.15, rel=0.1)
    assert not any(own.is_biased for result in results.values() for own in result.model.estimates.values())


def test_more_recordings_show_an_effect_of_half_the_noise_of_a_window():
    results = identify([swing(seed, 0.15, hidden=0.04) for seed in range(2, 12)])  # windows average 0.15 N m to 0.08
    assert [type(finding) for finding in results.findings] == [Incomplete]
    assert all(own.is_biased for result in results.values() for own in result.model.estimates.values())


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
    assert compute_white_p_values(np.zeros(len(place)), place, 25) == (1.0, 1.0, 1.0)
    assert min(compute_white_p_values(noise, place, 0)) > 1e-3  # windows so long that no lag is below the longest


def test_an_effect_above_the_bound_of_a_hidden_effect_is_rare():
    rng, place = np.random.default_rng(1), np.arange(400)
    for size in (0.0, 0.2, 0.5):
        slow = np.sqrt(2.0) * size * np.sin(2 * np.pi * place / 30.0)
        bounds = np.array([bound_hidden_effect(rng.standard_normal(400) + slow, place, 0.05) for _ in range(400)])
        assert np.mean(bounds < 0.98 * size) < 0.1 and np.median(bounds) < size + 0.35
