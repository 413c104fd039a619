"""Through a turn, a model with the plant's own parameters goes where the plant went, and no other does."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.independent_plant import Experiment, simulate
from estimators.online.turns import TURN, Mover, TurnFinder, Turns
from pendulum_env.physics import BASE
from pendulum_env.physics import simulate as pendulum
from pendulum_env.physics.library import effect
from tests.cases import PLANT, TRUTH
from tests.terms import Table

RATE, DELAY, LATE = 500.0, 7, 1
LEAST = 1e-3  # [N m]


STRIBECK = {"strib_d": 0.5, "strib_v": 0.5}
PLANTS = {
    "own": PLANT,
    "heavier": replace(PLANT, inertia=1.02 * PLANT.inertia, gravity=1.02 * PLANT.gravity),
    "smoother": replace(PLANT, coulomb=0.8 * PLANT.coulomb),
    "stribeck": replace(PLANT, effects={"stribeck": STRIBECK}),
}


@cache
def turns_of(plant: str) -> Turns:
    """Those that a plant makes in eight seconds, found as they come."""
    (run,) = simulate([(PLANTS[plant], Experiment(rate=RATE, seconds=8.0, counts=2**24, seed=3))])
    return Turns.joined(found(run.time, run.position, np.r_[0.0, run.torque[:-1]], run.velocity))


def found(time, position, torque, velocity, begins=0, late=LATE):
    finder = TurnFinder(1, 1 / RATE, DELAY, late, 0.01)
    told = []
    for k in range(len(time)):
        smoothed = velocity[max(0, k - DELAY)]
        one = (np.array([value]) for value in (time[k], position[k], torque[k], smoothed, k - DELAY - begins))
        told += finder.take(*one).values()
    return told


def sizes(turns: Turns, theta=TRUTH) -> np.ndarray:
    return Mover(BASE, 1 / RATE).missed(turns, theta).sizes(LEAST)


def test_no_turn_reaches_back_to_before_a_run_began_and_none_is_at_rest():
    time = np.arange(0.0, 2.0, 1 / RATE)
    told = found(time, np.cos(4 * time), time, -4 * np.sin(4 * time), begins=round(0.7 * RATE))
    assert [round(turn.time[0] + TURN.half, 1) for turn in told] == [1.6]
    flicker = 1e-3 * np.sign(np.sin(60 * time))
    assert not found(time, 0.0 * time, time, flicker)


def test_the_plants_own_parameters_explain_its_turns_and_those_of_another_do_not():
    own = sizes(turns_of("own"))
    assert len(own) > 5
    assert np.exp(own[:, 1] / 2).max() < 0.01  # N m: of the two integrators
    for other in ("smoother", "stribeck"):
        assert np.median(sizes(turns_of(other))[:, 1]) > np.log(0.02**2)


def test_parameters_explain_another_value_but_not_another_structure():
    def left(plant: str) -> float:
        missed = Mover(BASE, 1 / RATE).missed(turns_of(plant), TRUTH)
        return float(np.median(missed.fitted(0.1 * TRUTH, 1e-10).sizes(LEAST)[:, 0]))

    assert left("heavier") < left("own") + 0.5
    assert left("stribeck") > left("own") + 3.0


def test_an_error_in_newton_metres_is_the_torque_that_makes_it():
    turns = turns_of("own")
    push = 0.05
    pushed = replace(turns, torque=turns.torque + push)  # said to be larger than what acted
    told = np.exp(sizes(pushed)[:, 1] / 2)
    assert np.median(told) == pytest.approx(push, rel=0.1)


def test_a_joint_that_sticks_throughout_hides_any_torque():
    """Its errors are no larger a torque than the largest there is."""
    count = round(2 * TURN.half * RATE)
    rest = Turns(np.zeros(1), np.full((count + 1, 1), 0.1), np.zeros(1), np.zeros((count, 1)), np.zeros((1, 1)))
    jump = 1e-3 * (np.arange(count + 1) > count // 2)[:, None]
    for turns, torque in ((rest, LEAST), (replace(rest, position=rest.position + jump), TURN.largest * LEAST)):
        np.testing.assert_allclose(sizes(turns)[0, 1], 2 * np.log(torque), atol=0.01)


OTHERS = [effect("dead_time")(0.013), effect("torque_offset")(), effect("friction_drift")(10.0)]


@pytest.mark.parametrize("term", OTHERS, ids=lambda term: term.id)
def test_a_model_of_any_terms_goes_where_it_goes_from_any_moment_on(term):
    """What it was told before a turn, and when that was, is what makes it."""
    terms, theta = (*BASE, term), np.r_[TRUTH, [0.3] * len(term.columns)]
    time = np.arange(0.0, 8.0, 1 / RATE)
    torque = 3.0 * np.sin(6.0 * time) + 2.0 * np.sin(2.3 * time)
    path = pendulum(terms, theta, 1 / RATE, torque, 0.0, 0.0)
    position, velocity = path.position[:-1, 0], path.velocity[:-1, 0]
    mover = Mover(terms, 1 / RATE)
    turns = Turns.joined(found(time, position, np.r_[0.0, torque[:-1]], velocity, late=10))
    assert mover.ready and len(turns.time) > 8
    assert np.exp(mover.missed(turns, theta).sizes(LEAST)[:, 1] / 2).max() < 2 * LEAST


def test_what_cannot_be_moved_through_a_turn_is_left_alone():
    assert not Mover((*BASE, effect("actuator_lag")(0.05)), 1e-3).ready  # it is not known what it held before
    assert not Mover((*BASE, Table()), 1e-3).ready
    assert not Mover(BASE, 0.2).ready
