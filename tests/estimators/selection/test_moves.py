"""Moves of the search, on a plant with air drag that another simulator made: each goes towards it and none away."""

from dataclasses import replace

import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.preprocessing import gather
from estimators.selection.models import Models
from estimators.selection.moves import alternatives, candidates, challenged, is_needed, revise, rivals, settle
from pendulum_env.physics import BASE, effect
from tests.cases import recorded

EFFECTS = ("quadratic_drag", "spring", "viscous_asymmetry", "torque_offset")
DRAG, SPRING, ASYMMETRY, OFFSET = (effect(id)() for id in EFFECTS)
RIGHT = (*BASE, DRAG)


@pytest.fixture(scope="module")
def models() -> Models:
    plant = Plant(effects={"quadratic_drag": {"drag": 0.05}})
    recordings = recorded(plant, Experiment(rate=500.0, seconds=10.0, seed=4))
    return Models(*gather(recordings), library={id: effect(id) for id in EFFECTS})


def test_what_is_hidden_is_the_most_promising_of_all_candidates(models):
    found = candidates(models, BASE)
    assert [term.id for term in found[0]] == [term.id for term in RIGHT]
    assert models.is_significant(found[0], BASE) and models.left.explained(found[0], BASE) > 0.9
    assert len(found) == len({longer[-1].id for longer in found}) <= len(EFFECTS)


def test_an_effect_that_nothing_needs_is_dropped_and_one_that_is_needed_stays(models):
    assert challenged(models, (*BASE, DRAG, SPRING), BASE) == RIGHT
    assert challenged(models, RIGHT, BASE) is None
    assert is_needed(models, RIGHT, BASE) and not is_needed(models, (*RIGHT, SPRING), RIGHT)


def test_an_effect_in_anothers_place_gives_way_to_it(models):
    assert set(revise(models, (*BASE, ASYMMETRY, OFFSET), BASE)) <= set(RIGHT)
    assert rivals(models, (*BASE, ASYMMETRY), ASYMMETRY)[0][-1] == DRAG
    assert ASYMMETRY not in [rival[-1] for rival in rivals(models, (*BASE, ASYMMETRY), ASYMMETRY)]


def test_nothing_else_is_possible_in_its_place(models):
    odds = alternatives(models, RIGHT, DRAG)
    assert odds["quadratic_drag"] > 0.99 and sum(odds.values()) == pytest.approx(1.0)


def test_a_model_that_is_settled_stays_as_it_is(models):
    cogged = settle(models, (*BASE, DRAG, effect("stribeck")(0.3)))
    assert settle(models, cogged)[-1].stribeck_velocity == pytest.approx(cogged[-1].stribeck_velocity, rel=0.01)
    assert settle(models, RIGHT) == RIGHT


def test_each_recording_has_weights_of_its_own_be_it_fitted_or_held_out(models):
    recording = models.train.recordings[0]
    apart = Models(*gather([recording], [replace(recording, name="another")]))
    assert len(set(apart.bootstrap.of_block.tolist())) == 2
    assert len(set(models.bootstrap.of_block.tolist())) == 1  # the end of one recording is no other
