"""A verdict of "nothing" says what it could have seen, and is held to it."""

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators import IdentificationError, add, diagnose
from estimators.data.split import split_recordings
from estimators.diagnosis.caveats import UnknownScale, find_caveats
from estimators.diagnosis.questions import find_detectable_effects, find_detectable_size
from estimators.diagnosis.result import Detectable
from estimators.selection.evidence import Evidence
from pendulum_env.physics import BASE, effects
from pendulum_env.recording import Recording
from tests.cases import diagnosed, recorded
from workbench.narrator.diagnosis import describe_detectable

EXPERIMENT = Experiment(rate=500.0, seconds=10.0, seed=4)


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    return Evidence.from_data(*split_recordings(recorded(Plant(), EXPERIMENT)))


@pytest.mark.slow
@pytest.mark.parametrize(("id", "parameter"), [("quadratic_drag", "drag"), ("spring", "spring_k")])
def test_what_is_said_to_show_is_found_and_a_tenth_of_it_is_not(evidence, id, parameter):
    size = find_detectable_size(evidence, BASE, effects()[id])
    assert size is not None
    large, small = (recorded(Plant(effects={id: {parameter: share * size}}), EXPERIMENT) for share in (2, 0.1))
    found = diagnosed(large)
    assert id in {*found.selected, *(one for group in found.ambiguous for one in group)}
    assert diagnosed(small).selected == ()


def test_it_is_told_with_sizes_and_with_the_angles_that_were_reached(evidence):
    found = {one.effect: one for one in find_detectable_effects(evidence, BASE, effects())}
    assert found["stribeck"].above == find_detectable_size(evidence, BASE, effects()["stribeck"])
    assert found["stribeck"].unit == "N m" and found["hard_stop"].between == evidence.train.get_range()


def record_fast_motion(torque: float, frequencies: tuple[float, float], noise: float) -> list[Recording]:
    """Two recordings without any effect under a sweep of a torque [N m], of motion that is fast between reversals."""
    time, (low, high) = np.arange(2000) / 200, frequencies
    command = torque * np.sin(2 * np.pi * (low * time + (high - low) * time**2 / 20))
    experiments = [Experiment(200.0, 10.0, seed=seed, torque_noise=noise, counts=65_536) for seed in (1, 2)]
    return recorded(Plant(), *experiments, commands=[command, 1.05 * command])


def test_an_effect_that_would_show_only_beyond_the_applied_torque_is_not_excited_and_asked_for():
    fitted, held_out = record_fast_motion(10.0, (2.0, 4.0), 0.05)
    found = diagnose(fitted, held_out)
    assert not found.selected and not found.unexplained
    sizes = {one.effect: one for one in found.detectable}
    assert not sizes["stribeck"].is_excited and sizes["quadratic_drag"].is_excited
    assert found.suggestion is not None and "stribeck" in {aim.effect for aim in found.suggestion.settles}
    assert "not excited" in describe_detectable(sizes["stribeck"])


def test_an_added_effect_that_the_data_do_not_determine_is_refused_with_the_reason():
    fitted, held_out = record_fast_motion(5.0, (2.0, 2.5), 0.05)
    model = diagnose(fitted, held_out, only=["quadratic_drag"]).model
    with pytest.raises(IdentificationError, match="stribeck is not determined") as refused:
        add(model, "stribeck", fitted, held_out)
    assert refused.value.effect == "stribeck"
    assert add(model, "quadratic_drag", fitted, held_out).after.model.estimates["quadratic_drag"].std < 0.05


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_friction_by_load_may_scale_all_parameters_where_torque_drives_all_motion(share):
    """Strong friction stops the joint at once, so that a friction of mu |tau| is a smaller torque."""
    friction = {"load_dependent_friction": {"load_mu": share}} if share else {}
    experiment = Experiment(rate=500.0, seconds=20.0, seed=6, counts=16_384)
    time = np.arange(experiment.samples) / experiment.rate
    torque = 8.0 * np.sin(2 * np.pi * 0.2 * time) + 3.0 * np.sin(2 * np.pi * 0.47 * time + 1)
    runs = recorded(Plant(0.1, 0.0, 3.0, 0.5, friction), experiment, commands=[torque])
    found = diagnosed(runs, only=["load_dependent_friction", "cogging"])
    assert found.model.estimates["viscous"].value == pytest.approx(3.0 / (1 - share), rel=0.01)
    assert found.model.estimates["inertia"].value == pytest.approx(0.1 / (1 - share), rel=0.01)
    assert any(isinstance(own, UnknownScale) for own in found.findings)
    evidence = Evidence.from_data(*split_recordings(runs))
    for size, is_found in ((0.02, False), (0.7, True)):  # that would show
        known = [Detectable(id, size, "1") for id, kind in evidence.library.items() if kind.can_hide_scale]
        caveats = find_caveats(evidence, found.steps, found.model.terms, known)
        assert any(isinstance(own, UnknownScale) for own in caveats) == is_found


def test_friction_by_load_does_not_scale_a_pendulum_that_gravity_turns(evidence):
    found = diagnosed(evidence.train.recordings)
    assert not any(isinstance(own, UnknownScale) for own in found.findings)
