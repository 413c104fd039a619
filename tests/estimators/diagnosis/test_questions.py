"""A verdict of "nothing" says what it could have seen, and is held to it."""

import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.split import split_recordings
from estimators.diagnosis.questions import find_detectable_effects, find_detectable_size
from estimators.selection.evaluator import ModelEvaluator
from pendulum_env.physics import BASE, effects
from tests.cases import diagnosed, recorded

EXPERIMENT = Experiment(rate=500.0, seconds=10.0, seed=4)


@pytest.fixture(scope="module")
def evaluator() -> ModelEvaluator:
    return ModelEvaluator(*split_recordings(recorded(Plant(), EXPERIMENT)))


@pytest.mark.slow
@pytest.mark.parametrize(("id", "parameter"), [("quadratic_drag", "drag"), ("spring", "spring_k")])
def test_what_is_said_to_show_is_found_and_a_tenth_of_it_is_not(evaluator, id, parameter):
    size = find_detectable_size(evaluator, BASE, effects()[id])
    assert size is not None
    large, small = (recorded(Plant(effects={id: {parameter: share * size}}), EXPERIMENT) for share in (2, 0.1))
    found = diagnosed(large)
    assert id in {*found.selected, *(one for group in found.ambiguous for one in group)}
    assert diagnosed(small).selected == ()


def test_it_is_told_with_sizes_and_with_the_angles_that_were_reached(evaluator):
    found = {one.effect: one for one in find_detectable_effects(evaluator, BASE, effects())}
    assert found["stribeck"].above == find_detectable_size(evaluator, BASE, effects()["stribeck"])
    assert found["stribeck"].unit == "N m" and found["hard_stop"].between == evaluator.train.get_range()
