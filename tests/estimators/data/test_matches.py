"""Effects that look like a residual: of those that explain it equally well, the simplest comes first."""

import numpy as np

from benchmarks.independent_plant import Experiment, Plant, simulate
from estimators import compare, identify
from estimators.data.matches import find_matches
from pendulum_env.physics import effects
from pendulum_env.recording import Recording


def test_a_constant_is_an_offset_before_it_is_a_spring_with_more_parameters():
    experiment = Experiment(500.0, 8.0, "two_tone", 3.0, 1)
    (run,) = simulate([(Plant(0.09, 2.0, 0.36, 0.9, {"torque_offset": {"offset": 0.3}}), experiment)])
    recording = Recording(run.time, run.position, run.torque, name="run")
    model = identify(recording).model
    (data, *_) = compare(model, recording).data.parts
    matches = find_matches(data, model)
    spring = next(match for match in matches if match.effect == "spring")
    first = [match for match in matches if round(match.share, 3) >= round(spring.share, 3)]
    assert {first[0].effect, first[1].effect} == {"torque_offset", "coulomb_asymmetry"}
    assert first[0].share > 0.95 and first[0].size == 1 < spring.size
    assert {match.effect for match in matches} <= set(effects())
    rest = data.residual(model.terms, model.theta) - matches[0].torque
    assert np.mean(rest**2) < 0.05 * np.mean((rest + matches[0].torque) ** 2)
