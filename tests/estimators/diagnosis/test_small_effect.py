"""An effect that is significant, but explains too little of a noisy torque to be selected, is a finding."""

import pytest

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import diagnose
from estimators.findings import Kind
from pendulum_env.recording import Recording


@pytest.mark.parametrize("is_hidden", [True, False])
def test_a_significant_effect_below_the_noise_is_a_finding(is_hidden):
    hidden = {"stribeck": {"strib_d": 0.3, "strib_v": 0.5}} if is_hidden else {}
    plant = Plant(0.0895, 2.01, 0.3638, 0.9163, hidden)
    experiments = [Experiment(200.0, 20.0, "two_tone", 1.0, seed, torque_noise=0.3) for seed in (1, 2)]
    runs = simulate([(plant, experiment) for experiment in experiments])
    fitted, held_out = (Recording(run.time, run.position, run.torque) for run in runs)
    found = diagnose(fitted, held_out, only=["stribeck", "cogging"])
    assert not found.selected
    small = [own for own in found.findings if own.kind is Kind.SMALL_EFFECT]
    assert [own.effects for own in small] == ([("stribeck",)] if is_hidden else [])
    for own in small:
        assert 0 < own.numbers["share"].value < own.numbers["least"].value and own.numbers["p_value"].value < 0.01
