"""Dry friction of slow motion: windows of torque leave it out, and free motion shows it."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import add, diagnose
from estimators.data.regression_data import RegressionData
from estimators.selection.dry_friction import screen_dry_friction
from estimators.selection.evidence import Evidence
from pendulum_env.physics import BASE, effects, is_dry
from pendulum_env.recording import MovedTorque, Recording
from tests.cases import make_plain_model, recorded
from tests.slow import but_first

RATE, SECONDS = 500.0, 12.0
FRICTION = [id for id, kind in effects().items() if is_dry(kind())]


def swept(size: float, speed: float, seed: int) -> tuple[Recording, Recording]:
    """Two recordings under a torque of 3 N m whose frequency rises to 3 Hz."""
    hidden = {"stribeck": {"strib_d": size, "strib_v": speed}} if size else {}
    time = np.arange(round(RATE * SECONDS)) / RATE
    commands = [
        3.0 * np.sin(2 * np.pi * (begin * time + (3.0 - begin) * time**2 / (2 * SECONDS))) for begin in (0.1, 0.17)
    ]
    experiments = [Experiment(RATE, SECONDS, seed=seed + k, torque_noise=0.03, counts=65_536) for k in (1, 2)]
    fitted, held_out = recorded(Plant(effects=hidden), *experiments, commands=commands)
    return fitted, held_out


def test_friction_that_acts_at_rest_is_dry():
    assert {"stribeck", "position_dependent_friction", "load_dependent_friction"} <= {*FRICTION}
    assert not {"quadratic_drag", "presliding", "cogging", "backlash"} & {*FRICTION}


@pytest.mark.parametrize(("size", "speed", "seed"), but_first([(0.45, 0.08, 10), (0.45, 0.05, 10), (0.4, 0.06, 30)]))
def test_friction_below_the_speeds_of_the_windows_is_found_by_free_motion(size, speed, seed):
    fitted, held_out = swept(size, speed, seed)
    found = diagnose(fitted, held_out, only=[*FRICTION, "cogging", "quadratic_drag"])
    evidence, terms = found.evidence, found.evidence.fits.base
    (candidate,) = (own for own in found.candidates if own.effect == "stribeck")
    assert found.selected == ("stribeck",) and candidate.gain.p_value < 0.05
    assert evidence.gain(candidate.terms, terms).p_value > 0.05  # windows do not show it
    for name, truth in (("stribeck", size), ("stribeck.stribeck_velocity", speed)):
        estimate = found.model.estimates[name]
        assert abs(estimate.value - truth) < 3 * estimate.std < 1.5 * truth


@pytest.mark.parametrize(("size", "speed", "seed"), but_first([(0.1, 0.3, 20), (0.1, 0.2, 10)]))
def test_friction_that_few_windows_of_torque_show_is_determined_by_free_motion(size, speed, seed):
    found = diagnose(*swept(size, speed, seed), only=[*FRICTION, "cogging", "quadratic_drag"])
    assert found.selected == ("stribeck",) and not found.unexplained
    for name, truth in (("stribeck", size), ("stribeck.stribeck_velocity", speed)):
        estimate = found.model.estimates[name]
        assert abs(estimate.value - truth) < 3 * estimate.std < 0.6 * truth


def test_add_accepts_what_diagnose_finds_by_free_motion():
    fitted, held_out = swept(0.45, 0.08, 10)
    found = diagnose(fitted, held_out, only=FRICTION)
    added = add(make_plain_model(), "stribeck", fitted, held_out)
    assert found.selected == ("stribeck",) and added.objection is None
    for name, estimate in found.model.estimates.items():
        assert abs(added.after.model.estimates[name].value - estimate.value) <= 0.1 * estimate.std


def test_a_known_parameter_leaves_the_evidence_of_free_motion():
    fitted, held_out = swept(0.45, 0.08, 10)
    found = diagnose(fitted, held_out, only=["stribeck", "quadratic_drag"], fixed={"gravity": 2.0})
    assert found.selected == ("stribeck",)


def test_without_a_misfit_of_the_motion_no_dry_friction_is_tried():
    fitted, held_out = map(lambda run: RegressionData.from_recordings([run]), swept(0.0, 0.1, 20))
    evidence = Evidence.from_data(fitted, held_out)
    assert not evidence.motion.is_misfit(evidence.fits.fit(BASE))
    assert screen_dry_friction(evidence, BASE) == []


def stepped_and_slow(size: float, seed: int) -> Recording:
    """Recording at 200 Hz: 8 s of random steps of torque between samples, then 6 s of a slow sine."""
    rng, count = np.random.default_rng(seed), 14_000
    edges, levels = np.cumsum(rng.integers(80, 250, 200)), rng.uniform(-5.0, 5.0, 201)
    steps, slow = levels[np.searchsorted(edges, np.arange(count))], 2.6 * np.sin(2.2e-3 * np.arange(count))
    command = np.where(np.arange(count) < 8000, steps, slow)
    plant = Plant(effects={"stribeck": {"strib_d": size, "strib_v": 0.12}} if size else {})
    experiment = Experiment(1000.0, 14.0, seed=seed, torque_noise=0.02, counts=65_536)
    (run,) = recorded(plant, experiment, commands=[command])
    between = 0.5 * (run.torque[:-5:5] + run.torque[5::5])
    return Recording(run.time[:-5:5], run.position[:-5:5], between, moved=MovedTorque(0.02, np.array([0.5, 0.5])))


@pytest.mark.parametrize(("size", "is_seen"), [(0.0, False), (0.2, True)])
def test_a_misfit_of_slow_motion_is_seen_beside_steps_that_the_log_leaves_uncertain(size, is_seen):
    for seed in (1, 3):
        data = RegressionData.from_recordings([stepped_and_slow(size, seed)])
        evidence = Evidence.from_data(data, data)
        assert evidence.motion.is_misfit(evidence.fits.fit(BASE)) == is_seen
