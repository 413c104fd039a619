"""Moves of the search, on a plant with air drag that another simulator made: each goes towards it and none away."""

from dataclasses import replace

import pytest

from benchmarks.independent_plant import Experiment, Plant
from estimators.data.split import split_recordings
from estimators.diagnosis.ranking import compute_alternatives
from estimators.selection.candidates import find_best_variant, refit_nonlinear, screen_effects, screen_replacements
from estimators.selection.evaluator import ModelEvaluator
from estimators.selection.moves import SearchState, revise
from pendulum_env.physics import BASE, effect
from tests.cases import recorded
from tests.motions import moved

EFFECTS = ("quadratic_drag", "spring", "viscous_asymmetry", "torque_offset")
DRAG, SPRING, ASYMMETRY, OFFSET = (effect(id)() for id in EFFECTS)
RIGHT = (*BASE, DRAG)


@pytest.fixture(scope="module")
def evaluator() -> ModelEvaluator:
    plant = Plant(effects={"quadratic_drag": {"drag": 0.05}})
    recordings = recorded(plant, Experiment(rate=500.0, seconds=10.0, seed=4))
    return ModelEvaluator(*split_recordings(recordings), library={id: effect(id) for id in EFFECTS})


def test_what_is_hidden_is_the_most_promising_of_all_candidates(evaluator):
    found = screen_effects(evaluator, BASE)
    assert [term.id for term in found[0]] == [term.id for term in RIGHT]
    assert evaluator.is_significant(found[0], BASE) and evaluator.residuals.explained_share(found[0], BASE) > 0.9
    assert len(found) == len({longer[-1].id for longer in found}) <= len(EFFECTS)


def test_an_effect_in_anothers_place_gives_way_to_it(evaluator):
    assert set(revise(SearchState(evaluator, BASE, (*BASE, ASYMMETRY, OFFSET))).terms) <= set(RIGHT)
    assert screen_replacements(evaluator, (*BASE, ASYMMETRY), ASYMMETRY)[0][-1] == DRAG
    assert ASYMMETRY not in [rival[-1] for rival in screen_replacements(evaluator, (*BASE, ASYMMETRY), ASYMMETRY)]


def test_nothing_else_is_possible_in_its_place(evaluator):
    odds = compute_alternatives(evaluator, RIGHT, DRAG)
    assert odds["quadratic_drag"] > 0.99 and sum(odds.values()) == pytest.approx(1.0)


def test_a_model_that_is_settled_stays_as_it_is(evaluator):
    cogged = refit_nonlinear(evaluator, (*BASE, DRAG, effect("stribeck")(0.3)))
    assert refit_nonlinear(evaluator, cogged)[-1].stribeck_velocity == pytest.approx(
        cogged[-1].stribeck_velocity, rel=0.01
    )
    assert refit_nonlinear(evaluator, RIGHT) == RIGHT


def test_each_recording_has_weights_of_its_own_be_it_fitted_or_held_out(evaluator):
    recording = evaluator.train.recordings[0]
    apart = ModelEvaluator(*split_recordings([recording], [replace(recording, name="another")]))
    assert len(set(apart.bootstrap.of_block.tolist())) == 2
    assert len(set(evaluator.bootstrap.of_block.tolist())) == 1  # the end of one recording is no other


def test_a_straight_spring_that_turns_gravity_round_gives_way_to_one_that_hardens():
    """Where the swing is small both fit alike, and only one of them leaves the weight what it is."""
    run = moved(lambda q, v: 0.1 * v + 0.5 * q**3, size=0.8)
    evaluator = ModelEvaluator(*split_recordings([run]), library={"spring": effect("spring")})
    straight, hardening = (trial.terms for trial in evaluator.train.variants(BASE, effect("spring")))
    assert evaluator.model(straight).estimates["gravity"].value < 0 and not evaluator.is_significant(
        hardening, straight
    )
    assert find_best_variant(evaluator, BASE, effect("spring")).terms == hardening
    assert evaluator.model(hardening).estimates["gravity"].value == pytest.approx(2.0, rel=0.01)
