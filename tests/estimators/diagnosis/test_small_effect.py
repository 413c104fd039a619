"""A significant effect matters if it changes the torque or the motion; one that changes neither much is a finding."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import diagnose
from estimators.diagnosis.small_effect import SmallEffect
from pendulum_env.recording import Recording
from tests.cases import recorded


@pytest.mark.parametrize("is_hidden", [True, False])
def test_a_significant_effect_below_the_noise_is_a_finding(is_hidden):
    hidden = {"stribeck": {"strib_d": 0.15, "strib_v": 0.5}} if is_hidden else {}
    plant = Plant(0.0895, 2.01, 0.3638, 0.9163, hidden)
    experiments = [Experiment(200.0, 20.0, "two_tone", 1.0, seed, torque_noise=0.3) for seed in (1, 2)]
    runs = simulate([(plant, experiment) for experiment in experiments])
    fitted, held_out = (Recording(run.time, run.position, run.torque) for run in runs)
    found = diagnose(fitted, held_out, only=["stribeck", "cogging"])
    assert not found.selected
    small = [own for own in found.findings if isinstance(own, SmallEffect)]
    assert [own.effect for own in small] == (["stribeck"] if is_hidden else [])
    for own in small:
        assert 0 < own.share < own.least and own.p_value < 0.01


def sweep(begin: float) -> np.ndarray:
    """A torque of 3 N m whose frequency rises to 5 Hz, 20 s at 200 Hz."""
    time = np.arange(4000) / 200
    return 3.0 * np.sin(2 * np.pi * (begin * time + (5.0 - begin) * time**2 / 40))


@pytest.mark.parametrize(("size", "noise"), [(0.15, 0.05), (0.3, 0.1), (0.0, 0.1)])
def test_friction_of_slow_motion_in_a_fast_sweep_is_found_by_its_motion(size, noise):
    hidden = {"stribeck": {"strib_d": size, "strib_v": 0.3}} if size else {}
    experiments = [Experiment(200.0, 20.0, seed=seed, torque_noise=noise, counts=65_536) for seed in (1, 2)]
    fitted, held_out = recorded(Plant(effects=hidden), *experiments, commands=[sweep(0.1), sweep(0.15)])
    found = diagnose(fitted, held_out)
    assert found.selected == (("stribeck",) if size else ()) and not found.ambiguous
    if size:
        first, last = (step.errors["holdout"] for step in (found.steps[0], found.steps[-1]))
        torque, motion = (getattr(last, name) / getattr(first, name) for name in ("torque_rms", "position_rms"))
        assert torque**2 > 1 - found.evidence.criterion.explained_share and motion < 0.5
        for name, truth in (("stribeck", size), ("stribeck.stribeck_velocity", 0.3)):
            estimate = found.model.estimates[name]
            assert abs(estimate.value - truth) < 3 * estimate.std
