"""What an engine is to push with: the same compiled and by NumPy, for every effect; and laws that are no formulas."""

import gymnasium as gym
import numpy as np
import pytest

from pendulum_env.backends.half_steps import Compiled, Interpreted, half_steps
from pendulum_env.physics import Samples, effects
from pendulum_env.physics.simulation import Balance
from pendulum_env.plant import hide, paper_plant
from pendulum_env.registration import PENDULUM
from tests.terms import Clipped, Table

H = 10e-3  # [s], in which terms with a link take many steps of their own
SHOWN = {"hard_stop": "hard_stop:upper=0.3", "payload_change": "payload_change:moment=0.5"}


def pushes(plant) -> np.ndarray:
    """What a plant is pushed with (N, 5), compiled and by NumPy, along a motion that starts, turns round, and rests."""
    balance = Balance(plant.terms, plant.theta)
    both = Compiled(balance, H), Interpreted(balance)
    for halves in both:
        rest = Samples(*np.zeros(4))
        halves.place(Samples(*np.zeros(4), balance.start(rest)))
    time, position, velocity, told = 0.0, 0.0, 0.0, []
    for k in range(300):
        torque = 3.0 * np.sin(0.08 * k) if k < 250 else 0.0
        state = time, position, velocity, torque, H
        program, numbers = (halves.push(*state) for halves in both)
        np.testing.assert_allclose(program, numbers, rtol=1e-9, atol=1e-9)
        told.append(program)
        reached = 4.0 * np.sin(0.06 * (k + 1)) if k < 250 else 0.0
        for halves in both:
            mean = 0.5 * (program.middle + reached)
            halves.complete(time + 0.5 * H, position + 0.5 * H * velocity, mean, torque, H)
        time, position, velocity = time + H, position + 0.5 * H * (velocity + reached), reached
    return np.array(told)


@pytest.fixture(scope="module")
def base() -> np.ndarray:
    return pushes(paper_plant())


@pytest.mark.parametrize("effect", [id for id in effects() if id != "dead_time"])  # which delays the command itself
def test_programs_push_as_numpy_does(effect, base):
    told = pushes(hide(paper_plant(), SHOWN.get(effect, effect)))
    assert np.abs(told - base).max() > 1e-3


def test_a_plant_whose_law_is_no_formula_moves_all_the_same():
    model = paper_plant()
    tables, formulas = (model.add(kind(), [0.7]) for kind in (Table, Clipped))
    assert isinstance(half_steps(Balance(tables.terms, tables.theta), H), Interpreted)
    assert isinstance(half_steps(Balance(formulas.terms, formulas.theta), H), Compiled)
    paths = []
    for plant in (tables, formulas):
        env = gym.make(PENDULUM, model=plant, counts=0)
        env.reset(seed=0)
        pushes = 4.0 * np.sin(0.004 * np.arange(1500, dtype=np.float32))[:, None]
        paths.append([env.step(push)[-1]["position"] for push in pushes])
    assert np.ptp(paths[0]) > 1.0
    np.testing.assert_allclose(*paths, rtol=0, atol=1e-9)
